"""The mask of a run: what `--mask` chooses, what the method then sees, and what is written down."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.bench.records.record import RunRecord, read_record
from panobench.bench.run import masking
from panobench.bench.run.masking import MaskChoice, apply_mask, choose_mask, read_mask_for
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.bench.run.views import ChosenFrames, FrameReader
from panobench.bench.suite.artifacts import artifact_checksums
from panobench.cameras.erp import ErpCamera
from panobench.cli.run import summary
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import read_image, write_image
from panobench.errors import DatasetError, UnknownNameError, UsageError
from panobench.masks.base import MaskEstimate, MaskEstimator
from panobench.masks.files import read_mask_file
from panobench.plugins import Registered, registry
from panobench.specs import MaskSpec, MethodSpec
from panobench.testing import TinySequence, erp_camera
from panobench.types import Estimate

pytestmark = pytest.mark.usefixtures("fake_plugin")
LOWER = np.arange(64)[:, None].repeat(128, axis=1) >= 48


class Lower(MaskEstimator):
    """Hides the lowest quarter."""

    seen: FrameSequence | None = None

    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        type(self).seen = sequence
        return MaskEstimate(~LOWER, message="a quarter is hidden", details={"pairs": 1})


class Fails(MaskEstimator):
    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        raise DatasetError("no frame can be read")


@pytest.fixture
def estimators(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = dict(registry().entries["mask"])
    for cls in (Lower, Fails):
        monkeypatch.setattr(masking, cls.__name__, cls, raising=False)
        spec = MaskSpec(cls.__name__.lower(), "for tests", f"panobench.bench.run.masking:{cls.__name__}")
        entries[spec.name] = Registered(spec, "test")
    monkeypatch.setitem(registry().entries, "mask", entries)


def run(tmp_path: Path, mask: str | None, **options: Any) -> tuple[Path, RunRecord]:
    request = RunRequest(method="fake-still", dataset="tiny", width=128, mask=mask, **options)
    folder = execute(request, tmp_path / "run", force=True)
    return folder, read_record(folder)


def painted(tmp_path: Path, hidden: np.ndarray) -> Path:
    path = tmp_path / "painted.png"
    write_image(path, np.uint8(~hidden) * 255)
    return path


def test_recordings_are_looked_at_and_rendered_data_are_not() -> None:
    assert choose_mask(None, "video").source == "geometry"
    assert choose_mask(None, "rooms").source == ""
    assert choose_mask("auto", "rooms").source == "geometry"
    assert choose_mask("geometry", "rooms").source == "geometry"
    assert choose_mask("none", "video").source == ""


@pytest.mark.parametrize(
    ("mask", "error", "message"),
    [
        ("geometri", UnknownNameError, "did you mean 'geometry'"),
        ("geometry:3", UsageError, "takes no argument"),
        ("there/is/none.png", UsageError, "no such file"),
    ],
)
def test_mistakes_are_said_before_anything_runs(mask: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        choose_mask(mask, "rooms")


def test_a_file_hides_what_is_black_in_it(tmp_path: Path) -> None:
    path = painted(tmp_path, LOWER)
    folder, record = run(tmp_path, str(path))
    assert record.mask is not None
    assert (record.mask.source, record.mask.file) == ("file", "painted.png")
    area = ErpCamera(128, 64).solid_angle()
    assert record.mask.hidden == record.mask.found == pytest.approx(area[LOWER].sum() / area.sum(), abs=1e-5)
    assert np.array_equal(read_mask_file(folder / "mask.png", (128, 64)).valid, ~LOWER)
    assert (folder / "renders" / "hidden.jpg").is_file()
    assert f"{'mask':18}14.6% of the view hidden (painted.png)" in summary(folder, record)
    request = RunRequest(method="fake-still", dataset="tiny", width=128, mask=str(path))
    spec = registry().get(MethodSpec, "fake-still")
    before = artifact_checksums(request, spec, None)["mask"]
    painted(tmp_path, ~LOWER)
    assert artifact_checksums(request, spec, None)["mask"] != before


def test_a_file_of_another_size_is_resized_and_one_of_other_proportions_refused(tmp_path: Path) -> None:
    path = painted(tmp_path, LOWER)
    small = read_mask_for(ErpCamera(64, 32), path).valid
    assert small.shape == (32, 64)
    assert small[:24].all()
    assert not small[24:].any()
    write_image(path, np.full((64, 64), 255, np.uint8))
    with pytest.raises(UsageError, match="64x64 pixels, the images are 128x64"):
        read_mask_for(ErpCamera(128, 64), path)
    write_image(path, np.zeros((64, 128), np.uint8))
    with pytest.raises(UsageError, match="hides all of the view"):
        run(tmp_path, str(path))


def test_what_an_estimator_finds_is_hidden_and_said(tmp_path: Path, estimators: None) -> None:
    folder, record = run(tmp_path, "lower")
    assert record.mask is not None
    assert (record.mask.source, record.mask.message) == ("lower", "a quarter is hidden")
    assert record.mask.details == {"pairs": 1}
    assert record.mask.seconds is not None
    assert record.mask.found == pytest.approx(0.146, abs=0.002)
    assert "mask by lower: a quarter is hidden" in (folder / "log.txt").read_text()
    assert Lower.seen is not None
    assert Lower.seen.groundtruth is None  # estimators are as blind as methods


def test_an_estimator_that_fails_leaves_the_view_as_it_is(tmp_path: Path, estimators: None) -> None:
    folder, record = run(tmp_path, "fails")
    assert record.ok
    assert record.mask is not None
    assert not record.mask.ok
    assert record.mask.message == "no frame can be read"
    assert record.mask.hidden == 0
    assert not (folder / "mask.png").exists()


def test_without_a_mask_nothing_is_written(tmp_path: Path) -> None:
    folder, record = run(tmp_path, "none")
    assert record.mask is None
    assert not (folder / "mask.png").exists()
    assert "of the view hidden" not in summary(folder, record)


def test_masks_of_single_frames_reach_who_honours_them_and_are_joined_for_others() -> None:
    one, two = np.ones((64, 128), bool), np.ones((64, 128), bool)
    one[:8], two[:, :16] = False, False

    class Frames(MaskEstimator):
        whole: np.ndarray | None = None

        def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
            return MaskEstimate(~LOWER, {1: one, 2: two}, whole=self.whole)

    def applied(frame_masks: bool, whole: np.ndarray | None = None) -> ChosenFrames:
        Frames.whole = whole
        sequence = ChosenFrames(TinySequence(erp_camera(128), n=4))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(masking, "Frames", Frames, raising=False)
            spec = MaskSpec("frames", "for tests", "panobench.bench.run.masking:Frames")
            apply_mask(MaskChoice(spec), sequence, 0, print, frame_masks)
        return sequence

    joined = applied(False)
    assert np.array_equal(joined.camera.valid_mask(), ~LOWER & one & two)
    assert FrameReader(joined)(1).mask is None
    assert np.array_equal(applied(False, ~LOWER & one).camera.valid_mask(), ~LOWER & one)
    single = applied(True)
    assert np.array_equal(single.camera.valid_mask(), ~LOWER)
    read = FrameReader(single)
    assert read(0).mask is None
    frame = read(1)
    assert frame.mask is not None
    assert np.array_equal(frame.mask, one)
    assert not frame.image[~one].any()
    assert frame.image[one & ~LOWER].any()


def test_the_source_is_asked_once_for_the_mask_of_a_frame(tmp_path: Path) -> None:
    masks, asked = [LOWER | (np.arange(128) % (k + 2) > 0) for k in range(3)], []

    class Masked(TinySequence):
        def frame_mask(self, index: int) -> np.ndarray | None:
            asked.append(index)
            return masks[index] if index < 3 else None

    sequence = ChosenFrames(Masked(erp_camera(128), n=4))
    read = FrameReader(sequence)
    assert all(np.array_equal(read(k).mask, masks[k]) for k in range(3))
    masking.write_masks(tmp_path, tmp_path / "renders", sequence, {})
    written = [read_image(tmp_path / "masks" / f"{k:06d}.png")[..., 0] > 0 for k in range(3)]
    assert all(np.array_equal(a, b) for a, b in zip(written, masks))
    assert asked.count(0) == asked.count(1) == asked.count(2) == 1


class Walker(MaskEstimator):
    """Hides some columns of the third frame besides the lowest quarter of all."""

    visible = np.arange(128)[None, :].repeat(64, axis=0) >= 16

    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        return MaskEstimate(~LOWER, {2: self.visible})


def test_masks_of_single_frames_and_what_a_method_left_out_are_stored_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fake_plugin import Still

    moving = np.arange(128)[None, :].repeat(64, axis=0) < 96
    finish = Still.finish

    def with_moving(self: Still) -> Estimate:
        estimate = finish(self)
        estimate.moving = {2: moving}
        return estimate

    monkeypatch.setattr(masking, "Walker", Walker, raising=False)
    monkeypatch.setattr(Still, "finish", with_moving)
    spec = MaskSpec("walker", "for tests", "panobench.bench.run.masking:Walker")
    monkeypatch.setitem(registry().entries["mask"], "walker", Registered(spec, "test"))
    still = registry().entries["method"]["fake-still"]
    honours = Registered(replace(still.spec, frame_masks=True), still.origin)
    monkeypatch.setitem(registry().entries["method"], "fake-still", honours)
    folder, record = run(tmp_path, "walker", max_frames=4)
    assert record.mask is not None
    assert record.mask.frames == 1
    assert "14.6% of the view hidden in all frames, more in 1 of them (walker)" in summary(folder, record)
    assert [p.name for p in (folder / "masks").iterdir()] == ["000002.png"]
    assert np.array_equal(read_mask_file(folder / "masks" / "000002.png", (128, 64)).valid, Walker.visible)
    assert np.array_equal(read_mask_file(folder / "moving" / "000002.png", (128, 64)).valid, moving)
    assert record.moving is not None
    assert (record.moving.frames, record.moving.mean) == (1, pytest.approx(0.25, abs=1e-3))
    drawn = read_image(folder / "renders" / "hidden.jpg").astype(int)
    red, green, blue = (drawn[..., k] for k in range(3))
    assert (red - green)[50:, 20:90].mean() > 60  # hidden in all frames
    assert (red - green)[5:40, 2:14].mean() > 60  # hidden in this one
    assert (red - blue)[5:40, 100:].mean() > 60  # left out by the method: red and green
    assert (red - green)[5:40, 100:].mean() < 60

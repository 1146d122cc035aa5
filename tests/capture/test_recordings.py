"""Whole recordings of the smallest room: each part does to the images what it says, and truth stays true."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.row_times import row_times
from panobench.capture.casting import cast
from panobench.capture.lenses import lenses
from panobench.capture.parts import Parts
from panobench.capture.scene import RayField
from panobench.capture.sequence import CapturedSequence
from panobench.capture.studio import RoomStudio
from panobench.capture.walkers import Floor
from panobench.datasets.base import FrameSequence
from panobench.datasets.open import open_sequence
from panobench.datasets.synthetic.disturbed import DisturbedDataset, DisturbedSequence
from panobench.errors import UsageError
from panobench.plugins import registry
from panobench.specs import DatasetSpec
from panobench.testing import check_spec


def recording(name: str, width: int = 96) -> CapturedSequence:
    sequence = open_sequence("disturbed", name, width=width)
    assert isinstance(sequence, CapturedSequence)
    return sequence


def studio(name: str, width: int = 96) -> RoomStudio:
    room = recording(name, width)._room
    assert room is not None
    return room


@pytest.fixture(scope="module")
def plain() -> FrameSequence:
    return open_sequence("rooms", "tiny", width=96)


def test_an_operator_hides_the_scene_and_nothing_else(plain: FrameSequence) -> None:
    operated = recording("tiny+operator-15")
    carrier, walkers = operated.hidden(3)
    assert not walkers.any()
    difference = np.abs(operated.image(3).astype(int) - plain.image(3)).max(axis=-1)
    assert np.median(difference[carrier]) > 30
    edge = carrier | np.roll(carrier, 1, 0) | np.roll(carrier, -1, 0) | np.roll(carrier, 1, 1) | np.roll(carrier, -1, 1)
    assert np.percentile(difference[~edge], 99) <= 8  # noise and the encoding
    assert plain.groundtruth is not None
    assert operated.groundtruth is not None
    assert np.allclose(operated.groundtruth.T_wc, plain.groundtruth.T_wc, atol=1e-9)
    assert np.allclose(operated.depth(3), plain.depth(3), rtol=1e-6)
    assert np.array_equal(operated.image(3), operated.image(3))


def test_walkers_keep_to_the_floor_and_away_and_are_hidden_by_what_is_nearer() -> None:
    room = studio("tiny+walkers-2")
    walkers = room.walkers
    assert walkers is not None
    shot = room.shoot(4)
    covered = shot.walkers > 0.5
    assert covered.any()
    floor = Floor.of(room.scene.world.plan.mesh, room.T_wc[:, :3, 3])
    for path in walkers._paths:
        gap = np.linalg.norm(path[:, None] - floor.places[None], axis=-1).min(axis=1)
        assert gap.max() < 0.3
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert np.median(steps) == pytest.approx(0.01, rel=0.05)
    t = float(room.times[4])
    field, T = RayField.of(room.camera), room.T_wc[4]
    light = room.scene.light(T)
    free = cast(walkers.solids(t), field.bundle.rays, T, light).share > 0.5
    assert covered.sum() < free.sum()  # furniture is in between
    assert (free | ~covered).all()


def test_rows_are_seen_from_where_the_camera_is_when_they_are_read() -> None:
    """Each row of a rolling shutter is that row of a picture taken at its own time."""
    rolled, still = studio("tiny+rolling-40ms+turn-200", 128), studio("tiny+turn-200", 128)
    index = int(np.argmax([abs(still.ride.rate(float(t))[1]) for t in still.times]))
    t = float(still.times[index])
    image, field = rolled.shoot(index).linear, RayField.of(still.camera)
    times = row_times(still.camera, field.rays)[:, 32] * 0.040  # the rim of a lens: whole rows at once, nearly
    for row in (16, 32, 48):
        own = still.scene.radiance(field, still.ride.pose(t + times[row]))
        now = still.scene.radiance(field, still.ride.pose(t))
        columns = slice(30, 34)
        error = np.abs(image[row, columns] - own[row, columns]).mean()
        assert error < 0.01
        if row != 32:
            assert np.abs(image[row, columns] - now[row, columns]).mean() > 3 * error


def test_exposure_blurs_what_moves() -> None:
    sharp, blurred = (studio(f"tiny+turn-200{more}") for more in ("", "+blur-60ms"))
    index = int(np.argmax([abs(sharp.ride.rate(float(t))[1]) for t in sharp.times]))
    a, b = sharp.shoot(index).linear, blurred.shoot(index).linear
    gradient = [np.abs(np.diff(x, axis=1))[30:60].mean() for x in (a, b)]
    assert gradient[1] < 0.8 * gradient[0]
    assert a.mean() == pytest.approx(b.mean(), rel=0.02)


def test_a_stitched_picture_is_each_lenss_own_and_their_mean_at_the_seam() -> None:
    room = studio("tiny+stitch-100mm")
    image, field = room.shoot(3).linear, RayField.of(room.camera)
    own = []
    for lens in lenses(field.rays, 0.1):
        T = room.T_wc[3].copy()
        T[:3, 3] += T[:3, :3] @ lens.origin
        own.append(room.scene.radiance(field.with_rays(lens.rays(field.rays)), T))
    front, back = (lens.weight for lens in lenses(field.rays, 0.1))
    assert np.abs(image - own[0])[front == 1].mean() < 1e-3
    assert np.abs(image - own[1])[back == 1].mean() < 1e-3
    seam = (front > 0.3) & (back > 0.3)
    assert np.abs(image - (front[..., None] * own[0] + back[..., None] * own[1]))[seam].mean() < 2e-3
    assert np.abs(own[0] - own[1])[seam].mean() > 0.01  # they differ there


def test_levelled_pictures_have_level_truth() -> None:
    room = recording("tiny+gait-300+levelled")
    truth = room.groundtruth
    assert truth is not None
    assert np.allclose(truth.T_wc[:, :3, 1], [0, 0, -1], atol=1e-9)
    points = RayField.of(room.camera).rays * np.asarray(room.depth(2))[..., None]
    world = points @ truth.T_wc[2, :3, :3].T + truth.T_wc[2, :3, 3]
    low = world[..., 2][np.isfinite(world[..., 2])]
    assert np.percentile(low, 2) == pytest.approx(0.0, abs=0.02)  # the floor is where it was
    assert room.imu is None


def test_the_codec_and_image_parts_work_on_any_data(plain: FrameSequence) -> None:
    source = open_sequence("rooms", "tiny+frames8", width=96)
    packed = recording("tiny+frames8+h264-0.5")
    assert len(packed) == 8
    error = np.abs(packed.image(5).astype(int) - source.image(5)).mean()
    assert 0.5 < error < 20
    lenses = recording("tiny+lenses-0.5").image(0).astype(float) / np.maximum(plain.image(0), 1)
    front, back = np.median(lenses[40:56, 40:56]), np.median(np.concatenate([lenses[40:56, :8], lenses[40:56, -8:]]))
    assert abs(np.log2(front / back)) > 0.02


def test_what_cannot_be_is_said(plain: FrameSequence) -> None:
    class Other(FrameSequence):
        name, dataset, camera, times = "other", "other", plain.camera, plain.times

        def image(self, index: int) -> np.ndarray:
            return plain.image(index)

    with pytest.raises(UsageError, match="walkers needs a built-in room"):
        CapturedSequence(Other(), Parts(walkers=2), "other+walkers-2")
    with pytest.raises(UsageError, match="plain room"):
        open_sequence("disturbed", "tiny+blur2+operator-15", width=64)
    operated = CapturedSequence(Other(), Parts(operator=0.15), "other+operator-15")
    carrier, _ = operated.hidden(2)
    assert 0.05 < carrier.mean() < 0.4


def test_parts_and_disturbances_go_together_and_keep_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    both = open_sequence("disturbed", "tiny+operator-15:noise=0.03", width=64)
    assert isinstance(both, DisturbedSequence)
    assert both.provenance()["recording"] == {"operator": 0.15}
    monkeypatch.setattr(DisturbedDataset, "sequences", lambda self: ["rooms/tiny+operator-15+rolling-15ms"])
    checks = check_spec(registry().get(DatasetSpec, "disturbed"))
    assert [f"{c.name}: {c.message}" for c in checks if c.outcome == "fail"] == []

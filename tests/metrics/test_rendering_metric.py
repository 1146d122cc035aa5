"""Which frames and views are judged, and that the reference views are what a camera would have seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.views import paper_views
from panobench.geometry import Sim3, so3_exp
from panobench.metrics.base import MetricInput
from panobench.metrics.image_quality import psnr
from panobench.metrics.perspective import PerspectiveCut, perspective_views
from panobench.metrics.rendering import rendering_metrics, spread, thin
from panobench.testing import TinySequence
from panobench.types import Estimate, NovelView, Trajectory


def test_reference_views_are_what_a_pinhole_camera_sees() -> None:
    sequence = TinySequence(ErpCamera(256, 128), n=2, seed=1)
    T = sequence.pose_at(0.1)
    panorama = (sequence.image_from(T) / 255).astype(np.float32)
    cuts = perspective_views(sequence.camera)
    assert [c.view.name for c in cuts] == ["front", "left", "right"]
    for cut in cuts:
        assert cut.camera.width == 3 * cut.camera.height == 144
        seen = (sequence.image_from(cut.pose(T), cut.camera) / 255).astype(np.float32)
        value = psnr(cut.image(panorama), seen)
        assert value is not None
        assert value > 44
        # a wrong direction or a flip would be far off
        assert (psnr(cut.image(panorama), seen[:, ::-1]) or 0) < 25


def test_limited_panoramas_give_fewer_views() -> None:
    assert [c.view.name for c in perspective_views(ErpCamera(256, 128, 140.0))] == ["front"]
    assert perspective_views(ErpCamera(256, 128, 100.0)) == []
    masked = np.ones((128, 256), bool)
    masked[:, :80] = False
    assert [c.view.name for c in perspective_views(ErpCamera(256, 128).with_mask(masked))] == ["front", "right"]


def test_a_narrow_pinhole_is_judged_on_its_own_frames() -> None:
    sequence = TinySequence(PinholeCamera.from_fov(96, 90.0, 60.0), n=4, seed=1)
    data = _input(sequence)
    values = rendering_metrics(data)
    assert "views" in data.notes
    assert values["psnr_db"] == pytest.approx(values["pano_psnr_db"])
    assert values["psnr_db"] > 50


def _input(sequence: TinySequence, renders: Path | None = None, holdout: list[int] | None = None) -> MetricInput:
    """An estimate in another world than the truth's, with a renderer that knows both."""
    gt = sequence.groundtruth
    assert gt is not None
    world = Sim3(0.5, so3_exp([0.2, 0.4, -0.3]), np.array([1.0, 2.0, 3.0]))
    estimate = Estimate(Trajectory(gt.times, world.apply_poses(gt.T_wc)))

    def render(camera, T):  # type: ignore[no-untyped-def]
        return (sequence.image_from(world.inverse().apply_poses(T), camera) / 255).astype(np.float32)

    return MetricInput(sequence, estimate, list(range(len(sequence))), holdout or [], [], render, renders)


class WithNovelViews(TinySequence):
    def novel_views(self) -> list[NovelView]:
        T = self.pose_at(0.3) @ Sim3(1.0, so3_exp([0, 1.0, 0]), np.array([0.2, 0, 0])).apply_poses(np.eye(4))
        return [NovelView("n", self.image_from(T), self.camera, T)]


def test_novel_views_are_rendered_in_the_maps_world(tmp_path: Path) -> None:
    sequence = WithNovelViews(ErpCamera(128, 64), n=6, seed=1)
    values = rendering_metrics(_input(sequence, tmp_path / "renders", [2]))
    assert values["novel_psnr_db"] > 50
    assert values["holdout_psnr_db"] > 50
    names = sorted(p.name for p in (tmp_path / "renders").iterdir())
    assert names == [f"{i:06d}{s}.jpg" for i in range(6) for s in ("", "_gt")] + ["novel_000.jpg", "novel_000_gt.jpg"]


def test_held_out_frames_do_not_enter_the_seen_ones() -> None:
    sequence = TinySequence(ErpCamera(128, 64), n=6, seed=1)
    data = _input(sequence, holdout=[3])
    render = data.render
    assert render is not None
    gt = data.estimate.trajectory

    def worse_when_held_out(camera, T):  # type: ignore[no-untyped-def]
        image = render(camera, T)
        held = np.allclose(T[:3, 3], gt.T_wc[3, :3, 3])
        return 1 - image if held else image

    data.render = worse_when_held_out
    values = rendering_metrics(data)
    assert values["pano_psnr_db"] > 50
    assert values["psnr_db"] > 25
    assert values["holdout_psnr_db"] < 20
    assert values["holdout_views_psnr_db"] < 20


def test_renders_with_nan_are_black_there_and_odd_shapes_are_refused() -> None:
    sequence = TinySequence(ErpCamera(128, 64), n=3, seed=1)
    data = _input(sequence)
    data.render = lambda camera, T: np.full((camera.height, camera.width, 3), np.nan, np.float32)
    black = rendering_metrics(data)["pano_psnr_db"]
    data.render = lambda camera, T: np.zeros((camera.height, camera.width, 3), np.float32)
    assert rendering_metrics(data)["pano_psnr_db"] == black
    data.render = lambda camera, T: np.zeros((3, 3, 3), np.float32)
    from panobench.errors import UnsupportedError

    with pytest.raises(UnsupportedError, match="expected"):
        rendering_metrics(data)
    data.render = lambda camera, T: None
    assert rendering_metrics(data) == {}
    assert "no map" in data.notes["psnr_db"]


def test_choice_of_frames() -> None:
    assert thin(list(range(100)), 20) == list(range(0, 100, 5))
    assert thin(list(range(39)), 20) == list(range(39))
    assert thin([], 20) == []
    assert spread(list(range(100)), 8)[0] == 0
    assert spread(list(range(100)), 8)[-1] == 99
    assert len(spread(list(range(100)), 8)) == 8
    assert spread([5], 8) == [5]
    assert spread([], 8) == []


def test_cut_of_a_pinhole_needs_an_overlap() -> None:
    from panobench.errors import UnsupportedError

    with pytest.raises(UnsupportedError, match="sees nothing"):
        PerspectiveCut(PinholeCamera.from_fov(96, 60.0, 40.0), paper_views(96)[1])


class WithSomebody(TinySequence):
    """Somebody black stands to the left in all frames, and is known to."""

    hidden = np.arange(128)[None, :].repeat(64, axis=0) < 24

    def image(self, index: int) -> np.ndarray:
        return np.where(self.hidden[..., None], 0, super().image(index)).astype(np.uint8)

    def frame_mask(self, index: int) -> np.ndarray:
        return ~self.hidden


def test_what_masks_of_single_frames_hide_counts_in_no_score() -> None:
    values = rendering_metrics(_input(WithSomebody(ErpCamera(128, 64), n=4, seed=1)))
    bare = rendering_metrics(_input(TinySequence(ErpCamera(128, 64), n=4, seed=1)))
    for name in ("pano_psnr_db", "ws_psnr_db", "psnr_db"):
        assert values[name] > 50
    assert values["direct_psnr_db"] == pytest.approx(bare["direct_psnr_db"], abs=2.0)

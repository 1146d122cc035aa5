"""PanoGS end to end on a small built-in room, and its rules."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from panogs_options import configured

from panobench.bench.run.config import override
from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth.base import DepthEstimator
from panobench.depth.bootstrap import BootstrapDepth
from panobench.depth.simple import OracleDepth
from panobench.geometry import umeyama
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PRESETS, KeyframeOptions, PanogsConfig
from panobench.methods.panogs.mapping.keyframes import is_keyframe
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.splatting.covisibility import overlap, update_window
from panobench.methods.splatting.seeding import equal_area_pixels, fill_depth, seed_gaussians, surface_normals
from panobench.methods.splatting.views import SeenGaussians, View
from panobench.splat.render import Renderer
from panobench.types import DepthEstimate, Estimate, Frame

FRAMES = 30


def run(config: PanogsConfig, depth: type, frames: int = FRAMES, seed: int = 0) -> tuple[Estimate, float, float]:
    """Estimate, ATE in metres and mean panorama PSNR on `tiny` at 256x128."""
    sequence = RoomsDataset().open("tiny", width=256)
    method = PanogsMethod(config)
    method.start(sequence.camera, MethodContext(seed=seed, make_depth=depth))
    for i in range(frames):
        truth = sequence.depth(i) if i == 0 and depth is OracleDepth else None
        method.track(Frame(i, float(sequence.times[i]), sequence.image(i), depth=truth))
    estimate = method.finish()
    assert sequence.groundtruth is not None
    truth_positions = sequence.groundtruth.positions[:frames]
    fit = umeyama(estimate.trajectory.positions, truth_positions)
    error = np.linalg.norm(fit.apply_points(estimate.trajectory.positions) - truth_positions, axis=1)
    psnr = []
    for i in range(0, frames, 6):
        image = method.render(sequence.camera, estimate.trajectory.T_wc[i])
        assert image is not None
        psnr.append(-10 * np.log10(np.mean((image - sequence.image(i) / 255.0) ** 2)))
    return estimate, float(np.sqrt(np.mean(error**2))), float(np.mean(psnr))


@pytest.mark.slow
def test_tracks_and_maps_a_room_without_being_given_depth() -> None:
    estimate, ate, psnr = run(PanogsConfig(), BootstrapDepth)
    assert len(estimate.trajectory) == FRAMES
    assert estimate.depth is not None
    assert estimate.depth.ok
    assert ate < 0.006
    assert psnr > 27.0


@pytest.mark.slow
def test_same_seed_gives_the_same_result_to_the_bit() -> None:
    config = configured(mapping__iterations=6, start__iterations=6)
    a, _, _ = run(config, OracleDepth, frames=10)
    b, _, _ = run(config, OracleDepth, frames=10)
    assert np.array_equal(a.trajectory.T_wc, b.trajectory.T_wc)
    assert a.map is not None
    assert np.array_equal(a.map.means, b.map.means)


@pytest.mark.slow
def test_paper_preset_tracks() -> None:
    config = override(PanogsConfig(), {**PRESETS["paper"], "mapping.iterations": 8}, "option")
    estimate, ate, _ = run(config, OracleDepth, frames=8)
    assert len(estimate.trajectory) == 8
    assert ate < 0.05


def test_wide_views_have_fewer_keyframes() -> None:
    """A panorama still sees most of what it saw, so twice the way may lie between keyframes."""
    few, many = (
        run(
            configured(mapping__iterations=1, mapping__final_iterations=0, keyframes__wide=wide), OracleDepth, frames=14
        )[0]
        for wide in (2.0, 0.5)
    )
    assert 2 <= len(few.keyframes) < len(many.keyframes)


@pytest.mark.parametrize("value", [0, 255])
def test_a_sequence_without_texture_ends_without_an_exception(value: int) -> None:
    method = PanogsMethod(configured(mapping__iterations=2, start__iterations=2))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    for i in range(4):
        method.track(Frame(i, i / 15, np.full((32, 64, 3), value, np.uint8)))
    assert np.isfinite(method.finish().trajectory.T_wc).all()


def test_one_frame_is_enough_for_an_answer() -> None:
    method = PanogsMethod(configured(mapping__iterations=2, start__iterations=2))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    method.track(Frame(0, 0.0, np.random.default_rng(0).integers(0, 255, (32, 64, 3), dtype=np.uint8)))
    assert len(method.finish().trajectory) == 1


def test_a_first_depth_that_failed_its_check_is_said_at_once() -> None:
    class Failed(DepthEstimator):
        def start(self, camera: Camera, seed: int = 0) -> None:
            pass

        def add(self, frame: Frame) -> DepthEstimate:
            return DepthEstimate(np.full((32, 64), 2.0, np.float32), frame.index, ok=False, message="no depth to trust")

    said: list[str] = []
    method = PanogsMethod(configured(mapping__iterations=1, start__iterations=1))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=Failed, warn=said.append))
    method.track(Frame(0, 0.0, np.random.default_rng(0).integers(0, 255, (32, 64, 3), dtype=np.uint8)))
    assert said == ["no depth to trust"]


def test_nothing_at_all_is_an_empty_answer() -> None:
    method = PanogsMethod()
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    estimate = method.finish()
    assert len(estimate.trajectory) == 0
    assert estimate.map is None


def _view(index: int, x: float, seen: list[int]) -> View:
    T = np.eye(4)
    T[0, 3] = x
    return View(index, np.zeros((1, 1, 3), np.uint8), T, seen=_seen(20, seen))


def _seen(count: int, which: list[int]) -> SeenGaussians:
    """Of Gaussians 0 to count - 1, these."""
    return SeenGaussians(np.isin(np.arange(count), which))


def test_overlap_counts_what_both_see() -> None:
    a, b, ids = _seen(4, [0, 1, 2]), _seen(5, [1, 2, 3, 4]), np.arange(9, dtype=np.int32)
    assert overlap(a, b, ids) == pytest.approx(2 / 4)
    assert overlap(a, b, ids, "smaller") == pytest.approx(2 / 3)
    assert overlap(a, _seen(4, []), ids) == 0
    assert overlap(a, b, ids[[0, 1, 3, 5]]) == pytest.approx(1 / 3)  # Gaussian 2 is gone


def test_what_replaces_a_gaussian_is_seen_where_it_was() -> None:
    seen = _seen(4, [1, 3])
    seen.inherit(np.array([1, 2], np.int32), np.array([6, 7], np.int32), 8)
    assert np.flatnonzero(seen.seen).tolist() == [1, 3, 6]


def test_keyframe_rule() -> None:
    c = KeyframeOptions()
    assert not is_keyframe(c, 1.0, 0.02, 50, True)
    assert is_keyframe(c, 1.0, 0.09, 1, True)
    assert is_keyframe(c, 0.5, 0.06, 1, True)
    assert not is_keyframe(c, 0.5, 0.04, 1, True)
    assert is_keyframe(c, 0.5, 0.0, 5, False)
    assert is_keyframe(c, 1.0, 0.0, 4, True, new_share=0.05)


def test_window_protects_the_newest_two_and_drops_the_crowded() -> None:
    everything, ids = list(range(20)), np.arange(20, dtype=np.int32)
    window = [_view(k, x, everything) for k, x in ((4, 1.0), (3, 0.52), (2, 0.5), (1, 0.0))]
    kept = update_window(window, _view(5, 1.1, everything), 4, ids)
    assert [v.index for v in kept] == [5, 4, 3, 1] or [v.index for v in kept] == [5, 4, 2, 1]
    foreign = [*window[:3], _view(0, 0.1, [])]
    assert 0 not in [v.index for v in update_window(foreign, _view(5, 1.1, everything), 8, ids)]


def test_fill_depth_crosses_the_seam() -> None:
    depth = np.full((4, 16), np.nan, np.float32)
    depth[:, 15], depth[:, 8] = 3.0, 7.0
    assert (fill_depth(depth, wrap=True)[:, 0] == 3.0).all()
    assert (fill_depth(depth, wrap=False)[:, 0] == 7.0).all()


def test_equal_area_pixels_do_not_crowd_the_poles() -> None:
    camera: Camera = ErpCamera(128, 64)
    pixels = equal_area_pixels(camera, 4000, np.random.default_rng(0))
    assert len(pixels) == pytest.approx(4000, rel=0.02)
    polar = np.count_nonzero(pixels[:, 1] < 64 / 6)  # latitude above 60 degrees: 6.7% of the sphere
    assert polar / len(pixels) == pytest.approx((1 - np.sin(np.pi / 3)) / 2, rel=0.1)


def test_seeded_discs_lie_in_the_wall_and_reproduce_the_image() -> None:
    camera = ErpCamera(128, 64)
    rays = camera.rays()
    depth = (1.0 / np.abs(rays).max(axis=-1)).astype(np.float32)  # a cube of half width 1
    y, x = np.indices(depth.shape).reshape(2, -1)
    normals = surface_normals(camera, depth, x, y).reshape(64, 128, 3)
    inner = np.abs(rays).max(axis=-1) > 0.8
    assert np.median(np.abs(normals).max(axis=-1)[inner]) > 0.99
    image = np.zeros((64, 128, 3), np.uint8)
    image[..., 0], image[..., 1] = 200, 90
    pixels = equal_area_pixels(camera, 3000, np.random.default_rng(0))
    seeds = seed_gaussians(
        camera, image, depth, pixels, np.eye(4), np.sqrt(4 * np.pi / 3000),
        flatten=0.15, scale_factor=0.6, opacity=0.95,
    )  # fmt: skip
    assert np.abs(np.abs(seeds.means).max(axis=1) - 1).max() < 0.15
    out = Renderer(camera).forward(seeds, np.eye(4))
    assert np.median(out.opacity) > 0.9
    assert np.nanmedian(np.abs(out.expected_depth() / depth - 1)) < 0.03


@pytest.mark.parametrize(
    ("option", "value"),
    [("mapping.final_iterations", -1), ("mapping.iterations", -3), ("rates.colour", float("nan")),
     ("seeding.pixels_per_gaussian", 0), ("rates.beta2", 1.0), ("keyframes.window", 0), ("tracking.pixels", 0),
     ("keyframes.overlap", float("inf")), ("keyframes.wide", 0.0)],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(option: str, value: float) -> None:
    with pytest.raises(ValueError, match=option.partition(".")[2]):
        override(PanogsConfig(), {option: value}, "option")


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_presets_name_options_that_exist(preset: dict[str, Any]) -> None:
    override(PanogsConfig(), preset, "option")

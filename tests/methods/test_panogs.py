"""PanoGS end to end on a small built-in room, and its rules."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.datasets.rooms import RoomsDataset
from panobench.depth.bootstrap import BootstrapDepth
from panobench.depth.simple import OracleDepth
from panobench.geometry import umeyama
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PRESETS, PanogsConfig
from panobench.methods.panogs.keyframes import is_keyframe, overlap, update_window
from panobench.methods.panogs.surface import equal_area_pixels, fill_depth, seed_gaussians, surface_normals
from panobench.methods.panogs.system import PanogsMethod
from panobench.methods.panogs.views import View
from panobench.splat.render import Renderer
from panobench.types import Estimate, Frame

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
    config = PanogsConfig(mapping_iterations=6, initial_iterations=6)
    a, _, _ = run(config, OracleDepth, frames=10)
    b, _, _ = run(config, OracleDepth, frames=10)
    assert np.array_equal(a.trajectory.T_wc, b.trajectory.T_wc)
    assert a.map is not None
    assert np.array_equal(a.map.means, b.map.means)


@pytest.mark.slow
def test_paper_preset_tracks() -> None:
    config = PanogsConfig(**{**PRESETS["paper"], "mapping_iterations": 8})
    estimate, ate, _ = run(config, OracleDepth, frames=8)
    assert len(estimate.trajectory) == 8
    assert ate < 0.05


def test_wide_views_have_fewer_keyframes() -> None:
    """A panorama still sees most of what it saw, so twice the way may lie between keyframes."""
    few, many = (
        run(PanogsConfig(mapping_iterations=1, final_iterations=0, keyframe_wide=wide), OracleDepth, frames=14)[0]
        for wide in (2.0, 0.5)
    )
    assert 2 <= len(few.keyframes) < len(many.keyframes)


@pytest.mark.parametrize("value", [0, 255])
def test_a_sequence_without_texture_ends_without_an_exception(value: int) -> None:
    method = PanogsMethod(PanogsConfig(mapping_iterations=2, initial_iterations=2))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    for i in range(4):
        method.track(Frame(i, i / 15, np.full((32, 64, 3), value, np.uint8)))
    assert np.isfinite(method.finish().trajectory.T_wc).all()


def test_one_frame_is_enough_for_an_answer() -> None:
    method = PanogsMethod(PanogsConfig(mapping_iterations=2, initial_iterations=2))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    method.track(Frame(0, 0.0, np.random.default_rng(0).integers(0, 255, (32, 64, 3), dtype=np.uint8)))
    assert len(method.finish().trajectory) == 1


def test_nothing_at_all_is_an_empty_answer() -> None:
    method = PanogsMethod()
    method.start(ErpCamera(64, 32), MethodContext(make_depth=BootstrapDepth))
    estimate = method.finish()
    assert len(estimate.trajectory) == 0
    assert estimate.map is None


def _view(index: int, x: float, seen: list[int]) -> View:
    T = np.eye(4)
    T[0, 3] = x
    touched = np.zeros(20, np.int32)
    touched[seen] = 1
    return View(index, np.zeros((1, 1, 3), np.uint8), T, touched=touched)


def test_overlap_counts_what_both_see() -> None:
    a, b = np.array([1, 1, 1, 0], bool), np.array([0, 1, 1, 1, 1], bool)
    assert overlap(a, b) == pytest.approx(2 / 4)
    assert overlap(a, b, "smaller") == pytest.approx(2 / 3)
    assert overlap(a, np.zeros(4, bool)) == 0


def test_keyframe_rule() -> None:
    c, same, other = PanogsConfig(), np.ones(10, bool), np.array([1] * 5 + [0] * 5, bool)
    assert not is_keyframe(c, same, same, 0.02, 50, True)
    assert is_keyframe(c, same, same, 0.09, 1, True)
    assert is_keyframe(c, other, same, 0.06, 1, True)
    assert not is_keyframe(c, other, same, 0.04, 1, True)
    assert is_keyframe(c, other, same, 0.0, 5, False)


def test_window_protects_the_newest_two_and_drops_the_crowded() -> None:
    everything = list(range(20))
    window = [_view(k, x, everything) for k, x in ((4, 1.0), (3, 0.52), (2, 0.5), (1, 0.0))]
    kept = update_window(window, _view(5, 1.1, everything), 4)
    assert [v.index for v in kept] == [5, 4, 3, 1] or [v.index for v in kept] == [5, 4, 2, 1]
    foreign = [*window[:3], _view(0, 0.1, [])]
    assert 0 not in [v.index for v in update_window(foreign, _view(5, 1.1, everything), 8)]


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
    [("final_iterations", -1), ("mapping_iterations", -3), ("colour_rate", float("nan")), ("pixels_per_gaussian", 0),
     ("adam_beta2", 1.0), ("window", 0), ("tracking_pixels", 0), ("keyframe_overlap", float("inf")),
     ("keyframe_wide", 0.0)],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused(option: str, value: float) -> None:
    with pytest.raises(ValueError, match=option):
        PanogsConfig(**{option: value})
    for preset in PRESETS.values():
        PanogsConfig(**preset)

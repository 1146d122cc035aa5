"""Kernels against the float64 oracle: images and touch counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from splat_scenes import CAMERAS, CASES, POSE, gaussian_map, random_scene, reference, render_oracle

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import PanobenchError
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.splat.view import TILE_H, TILE_W, Projection


def check_images(
    gaussians: GaussianMap, camera_name: str, projection: Projection, stop: float = 0.0, **options: Any
) -> None:
    camera = CAMERAS[camera_name]
    want = reference(gaussians, camera, POSE, projection, **options)
    got = Renderer(camera, projection, stop=stop, **options).forward(gaussians, POSE, count_touched=True)
    assert got.colour.shape == (camera.height, camera.width, 3)
    assert want.steady.mean() > 0.9
    assert float(want.out.opacity.detach().max()) > 0.5
    tolerance = 2e-5 + stop
    for name, a, b, scale in (
        ("colour", got.colour, want.out.colour, 1.0),
        ("depth", got.depth, want.out.depth, 4.0),
        ("opacity", got.opacity, want.out.opacity, 1.0),
    ):
        error = np.abs(a - b.detach().numpy())[want.steady].max()
        assert error < tolerance * scale, f"{name}: {error:.2e}"
        assert a.dtype == np.float32
    unsteady = np.abs(got.opacity - want.out.opacity.detach().numpy())[~want.steady]
    assert (unsteady < 3 / 255).all()  # there, too, only Gaussians on the edge of the cut may differ
    counts = want.out.touched.numpy()
    assert counts.max() > 20
    assert np.abs(got.touched - counts).max() <= 2  # pixels where rounding decides about the cut
    assert np.abs(got.touched - counts).sum() <= 2 + counts.sum() // 1000


@pytest.mark.parametrize(("camera", "projection"), CASES)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_images_and_touch_counts_match_the_oracle(camera: str, projection: Projection, seed: int) -> None:
    check_images(random_scene(80, seed, camera, projection), camera, projection)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_dense_scene_with_early_stop(camera: str, projection: Projection) -> None:
    check_images(random_scene(300, 3, camera, projection, logit=2.0), camera, projection, stop=1e-4)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_low_pass_and_near_are_used(camera: str, projection: Projection) -> None:
    check_images(random_scene(60, 4, camera, projection), camera, projection, low_pass=1.5, near=2.0)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_alpha_saturates_and_nearer_comes_first(camera: str, projection: Projection) -> None:
    """Two opaque Gaussians in line, the far one first in memory: 0.99 of the near, 0.0099 of the far."""
    i, j = 21, 40
    d = CAMERAS[camera].rays()[i, j]
    g = gaussian_map([3 * d, 2 * d], scale=0.5, logit=30.0, colour=[[1, 0, 0], [0, 1, 0]])
    out = Renderer(CAMERAS[camera], projection).forward(g, np.eye(4))
    np.testing.assert_allclose(out.colour[i, j], [0.0099, 0.99, 0], atol=1e-5)
    np.testing.assert_allclose(out.opacity[i, j], 0.9999, atol=1e-6)
    np.testing.assert_allclose(out.depth[i, j], 2 * 0.99 + 3 * 0.0099, atol=1e-4)


def test_empty_map_is_black() -> None:
    for camera, projection in CASES:
        out = Renderer(CAMERAS[camera], projection).forward(GaussianMap.empty(), POSE, count_touched=True)
        assert not out.colour.any()
        assert not out.opacity.any()
        assert out.touched is not None
        assert out.touched.shape == (0,)


def test_only_tiles_within_the_field_of_view_are_drawn() -> None:
    """And those as they are in the full panorama."""
    g = random_scene(80, 5, "erp")
    half = ErpCamera(72, 36, hfov_deg=120.0, lat_min_deg=0.0)
    full, some = (Renderer(c, stop=0.0).forward(g, POSE).colour for c in (CAMERAS["erp"], half))
    valid = half.valid_mask()
    assert full[valid].any()
    np.testing.assert_array_equal(some[valid], full[valid])
    assert not some[:, :TILE_W].any()
    assert not some[2 * TILE_H :].any()


def test_projection_must_fit_the_camera() -> None:
    distorted = PinholeCamera.from_dict({**CAMERAS["pinhole"].to_dict(), "distortion": [0.1, 0, 0, 0]})
    wrong: list[tuple[Camera, Projection]] = [(CAMERAS["erp"], "pinhole"), (CAMERAS["pinhole"], "erp")]
    for camera, projection in [*wrong, (distorted, "pinhole")]:
        with pytest.raises(PanobenchError, match="projection"):
            Renderer(camera, projection)


def test_expected_depth_divides_by_opacity() -> None:
    g = gaussian_map([0, 0, 2.0], scale=0.3, logit=2.0)
    out = Renderer(CAMERAS["erp"]).forward(g, np.eye(4))
    depth = out.expected_depth(0.5)
    known = np.isfinite(depth)
    np.testing.assert_array_equal(known, out.opacity >= 0.5)
    assert known.any()
    np.testing.assert_allclose(depth[known], 2.0, rtol=1e-5)


def test_oracle_chunks_do_not_change_it() -> None:
    g = random_scene(30, 6, "erp")
    parameters = [torch.tensor(a, dtype=torch.float64) for a in g.arrays()]
    whole = render_oracle(parameters, ErpCamera(32, 16), np.eye(4))
    pieces = render_oracle(parameters, ErpCamera(32, 16), np.eye(4), chunk=30 * 100)
    for a, b in zip(whole, pieces):
        torch.testing.assert_close(a, b)

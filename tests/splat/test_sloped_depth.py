"""Depth that follows each footprint's surface."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.methods.splatting.seeding import equal_area_pixels, seed_gaussians
from panobench.splat.render import Renderer

CAMERA = ErpCamera(128, 64)


def box_depth() -> np.ndarray:
    """Radial depth inside a box: most walls are seen at an angle."""
    rays = CAMERA.rays()
    return (np.array([3.0, 2.0, 4.0]) / np.maximum(np.abs(rays), 1e-9)).min(axis=-1).astype(np.float32)


def rendered(sloped: bool) -> np.ndarray:
    pixels = equal_area_pixels(CAMERA, 2000, np.random.default_rng(0))
    image = np.full((64, 128, 3), 128, np.uint8)
    spacing = float(np.sqrt(4 * np.pi / 2000))
    gaussians = seed_gaussians(
        CAMERA, image, box_depth(), pixels, np.eye(4), spacing, flatten=0.15, scale_factor=0.55, opacity=0.9
    )
    return Renderer(CAMERA, low_pass=0.1).forward(gaussians, np.eye(4), sloped=sloped).expected_depth(0.9)


def test_overlapping_discs_on_oblique_walls_do_not_pull_depth_nearer() -> None:
    truth = box_depth()
    bias = {sloped: float(np.nanmedian(rendered(sloped) / truth - 1)) for sloped in (False, True)}
    assert bias[False] < -0.003  # nearer discs are composited first
    assert abs(bias[True]) < 0.3 * abs(bias[False])


def test_sloped_depth_refuses_to_be_differentiated() -> None:
    pixels = equal_area_pixels(CAMERA, 50, np.random.default_rng(0))
    image = np.zeros((64, 128, 3), np.uint8)
    gaussians = seed_gaussians(
        CAMERA, image, box_depth(), pixels, np.eye(4), 0.3, flatten=0.15, scale_factor=0.55, opacity=0.9
    )
    render = Renderer(CAMERA).forward(gaussians, np.eye(4), sloped=True)
    zero = np.zeros((64, 128, 3), np.float32)
    with pytest.raises(ValueError, match="sloped"):
        render.backward(zero, zero[..., 0])

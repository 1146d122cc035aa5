"""Even and odd rows drawn apart: together they are the whole image and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
from splat_scenes import CAMERAS, POSE, random_scene

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.splat.render import Renderer


def cameras() -> dict[str, Camera]:
    partial = np.ones((36, 72), bool)
    partial[20:, 10:60] = False
    fisheye = KannalaBrandtCamera(64, 48, 20, 21, 31, 25, (0.02, -0.01, 0.004, -0.0008))
    return {**CAMERAS, "part of a panorama": ErpCamera(72, 36).with_mask(partial), "fisheye": fisheye}


@pytest.mark.parametrize("name", list(cameras()))
def test_two_fields_are_the_image_and_its_gradient(name: str) -> None:
    camera = cameras()[name]
    scene = random_scene(150, 2, "pinhole" if name == "pinhole" else "erp", logit=1.0)
    whole = Renderer(camera, stop=0.0)
    fields = whole.fields()
    assert fields is not None
    full = whole.forward(scene, POSE, sum_weights=True, count_touched=True)
    drawn = [field.forward(scene, POSE, sum_weights=True, count_touched=True) for field in fields]
    for row, part in enumerate(drawn):
        assert part.planes.shape == (3, camera.height // 2, camera.width)
        np.testing.assert_array_equal(part.planes, full.planes[:, row::2])
        np.testing.assert_array_equal(part.depth, full.depth[row::2])
        np.testing.assert_array_equal(part.opacity, full.opacity[row::2])
    assert full.opacity.max() > 0.5
    assert full.touched is not None
    np.testing.assert_array_equal(sum(part.touched for part in drawn), full.touched)
    np.testing.assert_allclose(sum(part.weights for part in drawn), full.weights, rtol=1e-4, atol=1e-4)

    d = np.random.default_rng(0).normal(size=full.planes.shape).astype(np.float32)
    gradient = full.backward(d, planar=True)
    parts = [part.backward(d[:, row::2], planar=True) for row, part in enumerate(drawn)]
    scale = np.abs(gradient.packed).max(axis=0)
    np.testing.assert_allclose(sum(p.packed for p in parts) / scale, gradient.packed / scale, atol=1e-4)
    pose = np.sum([p.pose for p in parts], axis=0)
    np.testing.assert_allclose(pose, gradient.pose, atol=1e-3 * np.abs(gradient.pose).max())


def test_what_has_no_fields_says_so() -> None:
    assert Renderer(CAMERAS["erp"], "erp").fields() is None
    assert Renderer(ErpCamera(70, 35)).fields() is None

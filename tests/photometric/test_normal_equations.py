"""Normal equations in blocks and threads are those of a plain float64 sum."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import se3_exp
from panobench.photometric.normal_equations import normal_equations
from panobench.photometric.reference import ReferenceLevel
from panobench.photometric.warp import camera_code, project, sample

CAMERAS: list[Camera] = [ErpCamera(64, 32), PinholeCamera(60, 40, fx=35.0, fy=33.0, cx=29.0, cy=21.0)]
HUBER, CUT, GAIN, OFFSET = 0.05, 0.4, 0.1, -0.02


@pytest.mark.parametrize("camera", CAMERAS, ids=["erp", "pinhole"])
@pytest.mark.parametrize("n", [300, 9000])  # one thread and part of a block; two threads and many
@pytest.mark.parametrize("exposure", [False, True])
def test_they_are_the_plain_sums(camera: Camera, n: int, exposure: bool) -> None:
    rng = np.random.default_rng(n)
    code, cam = camera_code(camera)
    image = rng.random((camera.height, camera.width)).astype(np.float32)
    image[3, 5:9] = np.nan
    points = rng.normal(size=(3, n)).astype(np.float32) + np.float32([[0], [0], [1.0]])
    level = ReferenceLevel(
        points, rng.normal(size=(6, n)).astype(np.float32), rng.random(n).astype(np.float32),
        rng.uniform(0.2, 1, n).astype(np.float32), cam,
    )  # fmt: skip
    T = se3_exp([0.1, -0.2, 0.05, 0.3, 0.2, -0.1])
    found = normal_equations(level, image, code, T, GAIN, OFFSET, HUBER, CUT, exposure=exposure)

    u, v = np.empty(n, np.float32), np.empty(n, np.float32)
    project(*points, T[:3, :3].astype(np.float32), T[:3, 3].astype(np.float32), code, cam, u, v)
    seen = np.array([sample(image, a, b, code) for a, b in zip(u, v)], np.float64)
    e = seen - np.exp(GAIN) * level.value - OFFSET
    known = np.isfinite(e)
    size = np.abs(np.where(known, e, 0))
    cost = np.where(size <= HUBER, 0.5 * size**2, HUBER * (np.minimum(size, CUT) - 0.5 * HUBER))
    weight = np.where(known, level.weight, 0)
    pull = weight * np.where(size <= HUBER, 1, HUBER / np.maximum(size, HUBER)) * (size <= CUT)
    J = np.concatenate([np.exp(GAIN) * level.jacobian, np.exp(GAIN) * level.value[None], np.ones((1, n))])
    rows = 8 if exposure else 6
    H, b = (pull * J) @ J.T, (pull * J) @ np.where(known, e, 0)
    np.testing.assert_allclose(found.H[:rows, :rows], H[:rows, :rows], atol=2e-5 * np.abs(H).max())
    np.testing.assert_allclose(found.b[:rows], b[:rows], atol=2e-5 * np.abs(b).max() + 1e-4)
    assert found.cost == pytest.approx((weight * cost).sum() / weight.sum(), rel=1e-4)
    assert found.seen == pytest.approx(weight.sum() / level.weight.sum(), rel=1e-5)
    median = min(np.median(size[known]), 1023.5 / 4096)  # what the histogram tells apart
    assert found.sigma == pytest.approx(1.4826 * median, rel=0.1)

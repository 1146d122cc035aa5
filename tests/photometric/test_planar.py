"""The planar filter against the same sums in float64, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.photometric.planar import planar_filter

RADIUS, STRIDE, LUMA, DEPTH, FLOOR = 6, 2, 0.05, 0.03, 1e-3


def slow(depth: np.ndarray, trust: np.ndarray, luma: np.ndarray, rays: np.ndarray, wrap: bool) -> np.ndarray:
    h, w = depth.shape
    out = np.empty((h, w))
    for y in range(h):
        c = max(np.cos((0.5 - (y + 0.5) / h) * np.pi), 0.1) if wrap else 1.0
        reach, step = min(int(RADIUS / c), w // 4), max(int(STRIDE / c), 1)
        for x in range(w):
            rho, N, b = 1 / depth[y, x], np.zeros((3, 3)), np.zeros(3)
            for j in range(-RADIUS, RADIUS + 1, STRIDE):
                for i in range(-(reach // step) * step, reach + 1, step):
                    q, p = y + j, (x + i) % w if wrap else x + i
                    if not (0 <= q < h and 0 <= p < w):
                        continue
                    e = (1 / depth[q, p]) / rho - 1
                    k = trust[q, p] * np.exp(-abs(luma[q, p] - luma[y, x]) / LUMA - (e / DEPTH) ** 2)
                    N += k * np.outer(rays[q, p], rays[q, p])
                    b += k * rays[q, p] / depth[q, p]
            ridge = 1e-6 * np.trace(N) + 1e-9
            value = np.linalg.solve(N + ridge * np.eye(3), b + ridge * rho * rays[y, x]) @ rays[y, x]
            out[y, x] = 1 / value if 0.3 * rho < value < 3 * rho else depth[y, x]
    return out


@pytest.mark.parametrize("camera", [ErpCamera(64, 32), PinholeCamera.from_fov(48, 90.0, 70.0)], ids=["erp", "pinhole"])
def test_agrees_with_the_sums_in_double_precision(camera: Camera) -> None:
    rng = np.random.default_rng(0)
    rays = camera.rays().astype(np.float32)
    depth = (2.0 / np.abs(rays).max(axis=-1) * (1 + 0.01 * rng.standard_normal(rays.shape[:2]))).astype(np.float32)
    luma = np.kron(rng.random((16, 16)), np.ones((4, 4)))[: depth.shape[0], : depth.shape[1]].astype(np.float32)
    information = (rng.random(depth.shape) ** 4).astype(np.float32)
    wrap, out = camera.kind == "erp", np.empty_like(depth)
    planar_filter(depth, information, luma, rays, RADIUS, STRIDE, LUMA, DEPTH, FLOOR, wrap, out)
    want = slow(depth, information + FLOOR, luma, rays, wrap)
    assert np.quantile(np.abs(out / want - 1), 0.9) < 1e-4
    assert np.abs(out / want - 1).max() < 5e-3  # where few neighbours count: a half of the noise


def test_noise_on_a_wall_is_taken_out() -> None:
    camera = ErpCamera(256, 128)
    rays = camera.rays().astype(np.float32)
    inner = np.abs(rays).max(axis=-1) > 0.9
    exact = (2.0 / np.abs(rays).max(axis=-1)).astype(np.float32)
    noisy = (exact * (1 + 0.01 * np.random.default_rng(0).standard_normal(exact.shape))).astype(np.float32)
    ones, out = np.ones_like(exact), np.empty_like(exact)
    planar_filter(noisy, ones, np.zeros_like(exact), rays, RADIUS, STRIDE, LUMA, DEPTH, FLOOR, True, out)
    assert np.median(np.abs(out / exact - 1)[inner]) < 0.4 * np.median(np.abs(noisy / exact - 1)[inner])

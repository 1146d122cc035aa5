"""Panoramas of a box with patterned walls, a plain one, and a ball, from places apart; luma and depth are exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera
from panobench.geometry import make_pose, so3_exp
from panobench.photometric.stereo import WorkingScale

Array = NDArray[np.float64]

#: Half the edges of the box, metres; the ball's centre and radius.
BOX = np.array([2.0, 1.2, 1.6])
BALL, RADIUS = np.array([0.9, 0.5, 0.3]), 0.35


def cast(rays: Array, centre: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance (...) to the box or the ball along unit rays (..., 3), and where it is the ball."""
    with np.errstate(divide="ignore"):
        wall = np.min((np.sign(rays) * BOX - centre) / rays, axis=-1)
    b = rays @ (centre - BALL)
    inside = b**2 - ((centre - BALL) ** 2).sum() + RADIUS**2
    ball = np.where((inside > 0) & (b < 0), -b - np.sqrt(np.maximum(inside, 0)), np.inf)
    return np.minimum(wall, ball), ball < wall


def painted(X: Array, ball: NDArray[np.bool_]) -> Array:
    """Luma (...) of points (..., 3): waves on the walls, hardly any on the one at +x, others on the ball."""
    waves = sum(np.sin(X @ np.array(k) + j) for j, k in enumerate([(5, 3, -4), (-4, 6, 3), (3, -5, 7), (9, 2, 5)]))
    plain = X[..., 0] > BOX[0] - 1e-6
    return np.where(ball, 0.25 + 0.02 * waves, np.where(plain, 0.8 + 0.008 * waves, 0.55 + 0.06 * waves))


def points(views: PosedPanoramas, k: int) -> Array:
    """(H, W, 3) in the world, by the depth of view ``k``."""
    return np.asarray(views.T_wc[k, :3, 3] + views.depth[k][..., None] * views.rays(k))


def posed_views(width: int = 256) -> PosedPanoramas:
    """Seven views with exact depth."""
    camera = ErpCamera(width, width // 2)
    t = np.linspace(0, 1, 7)
    positions = np.stack([0.5 * np.sin(5 * t), 0.3 * np.cos(3 * t), 0.6 * t - 0.5], axis=1)
    T_wc = make_pose(so3_exp(np.stack([0.1 * t, t, 0 * t], axis=1)), positions)
    cases = [(camera.rays() @ T[:3, :3].T, T[:3, 3]) for T in T_wc]
    depths, balls = zip(*(cast(rays, centre) for rays, centre in cases))
    luma = [painted(c + d[..., None] * r, b) for (r, c), d, b in zip(cases, depths, balls)]
    scale = WorkingScale.of(camera, width)
    return PosedPanoramas(np.stack(luma).astype(np.float32), np.stack(depths).astype(np.float32), T_wc, scale)


def with_bulges(truth: PosedPanoramas) -> PosedPanoramas:
    """The same with depths too large, by 4% on the ball, 0.5% elsewhere; up to 8% too small on the plain wall."""
    depths = []
    for k, depth in enumerate(truth.depth):
        X = points(truth, k)
        bulge = 0.08 * np.exp(-((X[..., 1] - 0.3) ** 2 + X[..., 2] ** 2) / 0.25) * (X[..., 0] > BOX[0] - 0.01)
        ball = cast(truth.rays(k), truth.T_wc[k, :3, 3])[1]
        depths.append(depth * np.where(ball, 1.04, 1.005 - bulge))
    return replace(truth, depth=np.stack(depths).astype(np.float32))

"""Disturbances of the rendered frames: exposure, rolling shutter, occluder, black frames, motion blur."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise, se3_exp, se3_log
from panobench.rooms.options import RoomOptions

Array = NDArray[np.float64]


def gains(options: RoomOptions, n: int) -> Array:
    """Exposure factor of each frame before the tone curve, (n,)."""
    i = np.arange(n)
    stops = np.zeros(n)
    if options.exposure:

        def step(at: float) -> Array:
            return np.asarray(1 / (1 + np.exp(-(i - at * n) / 1.5)))

        stops += options.exposure * (-step(0.3) + 2 * step(0.55) - step(0.8))
    if options.rolling:
        stops += options.rolling * np.sin(2 * np.pi * i / 24.0)
    return np.asarray(2.0**stops)


def row_gain(options: RoomOptions, index: int, height: int) -> NDArray[np.float32] | None:
    """(H, 1, 1) factor on display-linear rows: a rolling shutter under changing exposure; None if there is none."""
    if not options.rolling:
        return None
    slant = 0.3 * options.rolling * np.cos(2 * np.pi * index / 24.0)
    return (2.0 ** (slant * (np.arange(height) / height - 0.5))).astype(np.float32)[:, None, None]


def is_black(options: RoomOptions, index: int, n: int) -> bool:
    """Whether frame ``index`` of ``n`` is black."""
    return n // 2 <= index < n // 2 + options.black


def occluder(options: RoomOptions, index: int, rays: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Opacity (H, W) and display-linear colour (H, W, 3) of the occluder, or None if there is none.

    It is a cap of the sphere with a wavy rim that moves round the camera. rays: (H, W, 3) unit rays, camera frame.
    """
    if not options.occluder:
        return None
    a = 0.045 * index + options.seed
    axis = np.array([np.sin(a), 0.35 * np.sin(0.31 * a + 1.0), np.cos(a)])
    axis /= np.linalg.norm(axis)
    e1 = np.cross([0.0, 1.0, 0.0], axis)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    along, s, t = rays @ axis, rays @ e1, rays @ e2
    around = np.arctan2(t, s)
    rim = 1 - 2 * options.occluder + 0.06 * np.sin(5 * around) + 0.04 * np.sin(9 * around + 1.0)
    soft = np.clip((along - rim) / 0.03 + 0.5, 0.0, 1.0)
    fold = 0.05 + 0.03 * np.sin(14 * s + 6 * np.sin(5 * t)) * np.cos(11 * t)
    colour = fold[..., None] * np.array([1.0, 0.85, 0.75])
    return soft.astype(np.float32), colour.astype(np.float32)


def shutter_poses(T_wc: Array, index: int, shutter: float, count: int) -> Array:
    """Poses (count, 4, 4) while the shutter is open, on the SE(3) geodesics to the neighbouring frames.

    shutter: share of the frame time for which it is open, centred on frame ``index`` of T_wc (N, 4, 4).
    """
    here = invert_pose(T_wc[index])
    ahead = se3_log(here @ T_wc[index + 1]) if index + 1 < len(T_wc) else None
    behind = se3_log(here @ T_wc[index - 1]) if index > 0 else None
    if ahead is None:
        ahead = -behind if behind is not None else np.zeros(6)
    if behind is None:
        behind = -ahead
    t = ((np.arange(count) + 0.5) / count - 0.5) * shutter
    steps = np.where(t[:, None] >= 0, t[:, None] * ahead, -t[:, None] * behind)
    return renormalise(T_wc[index] @ se3_exp(steps))


def median_flow(camera: Camera, depth: NDArray[np.float32], T_a: Array, T_b: Array) -> float:
    """Median image motion, in pixels, between frames a and b of the points in frame a.

    depth: (H, W) radial, of frame a. T_a, T_b: (4, 4) camera-to-world.
    """
    points = camera.rays() * depth[..., None]
    moved = points @ T_a[:3, :3].T + T_a[:3, 3]
    local = (moved - T_b[:3, 3]) @ T_b[:3, :3]
    uv, valid = camera.project(local)
    d = uv - camera.pixel_grid()
    if camera.kind == "erp":  # the shorter way across the seam
        d[..., 0] = (d[..., 0] + camera.width / 2) % camera.width - camera.width / 2
    size = np.linalg.norm(d, axis=-1)[valid & np.isfinite(depth)]
    return float(np.median(size)) if len(size) else 0.0

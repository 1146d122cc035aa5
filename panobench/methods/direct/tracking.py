"""Pose of a frame by direct alignment to the window's points, from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise, se3_exp
from panobench.methods.direct.kernels import FRAME, PATTERN, SIZE, frame_system
from panobench.methods.direct.window import GAIN_PRIOR, OFFSET_PRIOR, Window

Array = NDArray[np.float64]

#: Gauss-Newton iterations per level, finest first. The last number is for all coarser levels.
ITERATIONS = (6, 8, 10, 15)


@dataclass
class Alignment:
    """T_cw (4, 4). affine (2,): gain and offset. rms: of the patterns used, grey levels. seen: share of all points that
    are in view. used: share of those that are no outliers.
    """

    T_cw: Array
    affine: Array
    rms: float
    seen: float
    used: float


def align(window: Window, pyramid: list[NDArray[np.uint8]], T_cw: Array, affine: Array) -> Alignment | None:
    """Align a frame; ``T_cw`` is the initial pose. None if too few points are in view."""
    result = None
    for level in range(window.levels - 1, -1, -1):
        result = _align_level(window, pyramid, level, T_cw, affine)
        if result is None:
            return None
        T_cw, affine = result.T_cw, result.affine
    return result


def _align_level(
    window: Window, pyramid: list[NDArray[np.uint8]], level: int, T_cw: Array, affine: Array
) -> Alignment | None:
    c, face_set, p = window.config, window.face_set, window.points
    scale = 1.0 / (1 << level)
    colours = np.ascontiguousarray(p.colour[:, level])
    cut = SIZE * c.outlier**2
    T_wk, hosts = invert_pose(window.poses()), window.affines()
    prior = np.array([GAIN_PRIOR, OFFSET_PRIOR])

    def evaluate(T: Array, a: Array) -> tuple[float, int, int, Array, Array]:
        H, g = np.zeros((FRAME, FRAME)), np.zeros(FRAME)
        rel = T @ T_wk
        energy, seen, used = frame_system(
            pyramid[level], face_set.valid, scale, face_set.R_fc, face_set.intrinsics,
            np.ascontiguousarray(rel[:, :3, :3]), np.ascontiguousarray(rel[:, :3, 3]),
            p.host, p.bearing, p.rho, colours, a - hosts, 1.0 / (face_set.focal * scale), PATTERN,
            c.gradient_softening, c.huber, cut, H, g,
        )  # fmt: skip
        H[6, 6], H[7, 7] = H[6, 6] + prior[0], H[7, 7] + prior[1]
        g[6:] += prior * a
        return energy + float(np.sum(prior * a * a)), seen, used, H, g

    energy, seen, used, H, g = evaluate(T_cw, affine)
    if seen < max(30, 0.1 * len(p)):
        return None
    damping = 1e-3
    for _ in range(ITERATIONS[min(level, len(ITERATIONS) - 1)]):
        x = -np.linalg.solve(H + np.diag(damping * np.diag(H) + 1e-9), g)
        T_new, a_new = renormalise(se3_exp(x[:6]) @ T_cw), affine + x[6:]
        new, seen_new, used_new, H_new, g_new = evaluate(T_new, a_new)
        if seen_new >= 30 and new / seen_new < energy / seen:
            small = float(np.linalg.norm(x[:3])) < 1e-5 and float(np.linalg.norm(x[3:6])) < 1e-5
            T_cw, affine, energy, seen, used, H, g = T_new, a_new, new, seen_new, used_new, H_new, g_new
            damping *= 0.2
            if small:
                break
        else:
            damping *= 10
            if damping > 10:
                break
    rms = float(np.sqrt(max(0.0, energy - cut * (seen - used)) / max(1, used * SIZE)))
    return Alignment(T_cw, affine, rms, seen / len(p), used / max(1, seen))

"""Depths of panoramas that other panoramas confirm: what few see, or many see through, is left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.kernels.jit import PARALLEL, njit, prange
from panobench.photometric.warp import to_pixel

Float = NDArray[np.float32]

#: So many other views must agree, and more than see through.
LEAST = 2


def confirmed(depths: Float, T_wc: NDArray[np.float64], rays: Float, tolerance: float) -> Float:
    """The depths (K, H, W) that other views agree with, NaN elsewhere.

    depths: radial, NaN where unknown, of panoramas at poses (K, 4, 4) with unit rays (H, W, 3).
    tolerance: those that differ by less than this part agree.
    """
    K, height, width = depths.shape
    agree, through = np.zeros((2, *depths.shape), np.uint8)
    T_cw = np.ascontiguousarray(np.stack([invert_pose(T) for T in T_wc]), np.float32)
    cam = np.array([width, height, 0, 0, 0, 0], np.float32)
    _count(
        np.ascontiguousarray(depths), np.ascontiguousarray(T_wc, np.float32), T_cw, rays, cam, tolerance, agree, through
    )
    keep = (agree >= min(LEAST, K - 1)) & (agree > through) if K > 1 else np.ones(depths.shape, bool)
    return np.where(keep, depths, np.float32(np.nan))


@njit(**PARALLEL)  # type: ignore[misc, unused-ignore]
def _count(depths, T_wc, T_cw, rays, cam, tolerance, agree, through):  # type: ignore[no-untyped-def]
    """Write how many other views see a surface at each point, and how many see something behind it, both (K, H, W)."""
    views, height, width = depths.shape
    for row in prange(views * height):
        k, y = row // height, row % height
        for x in range(width):
            d = depths[k, y, x]
            if not d > 0:
                continue
            a, b, c, T = d * rays[y, x, 0], d * rays[y, x, 1], d * rays[y, x, 2], T_wc[k]
            X = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3]
            Y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3]
            Z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3]
            for j in range(views):
                if j == k:
                    continue
                S = T_cw[j]
                a = S[0, 0] * X + S[0, 1] * Y + S[0, 2] * Z + S[0, 3]
                b = S[1, 0] * X + S[1, 1] * Y + S[1, 2] * Z + S[1, 3]
                c = S[2, 0] * X + S[2, 1] * Y + S[2, 2] * Z + S[2, 3]
                u, v, _ = to_pixel(a, b, c, 0, cam)
                ratio = depths[j, min(max(int(v), 0), height - 1), min(max(int(u), 0), width - 1)] / np.sqrt(
                    a * a + b * b + c * c
                )
                if abs(ratio - 1) < tolerance:
                    agree[k, y, x] += 1
                elif ratio > 1 + 2 * tolerance:
                    through[k, y, x] += 1

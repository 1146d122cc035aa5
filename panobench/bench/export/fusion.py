"""Depths of panoramas fused into a grid of truncated signed distances, along the rays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.kernels.jit import PARALLEL

Float = NDArray[np.float32]


def fuse(
    depths: Float,
    T_wc: NDArray[np.float64],
    low: NDArray[np.float64],
    shape: tuple[int, ...],
    size: float,
    reach: float,
) -> tuple[Float, Float]:
    """(distance, weight) of the voxels (X, Y, Z): mean signed distance over ``reach``, positive in free space.

    depths (K, H, W): radial, NaN where unknown, of panoramas at poses (K, 4, 4). low (3,): centre of the first voxel;
    size: edge. A view counts by one over its distance, and not at all farther than ``reach`` behind the surface.
    """
    T_cw = np.ascontiguousarray(np.stack([invert_pose(T) for T in T_wc]))
    distance, weight = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    _fuse(np.ascontiguousarray(depths), T_cw, np.asarray(low, np.float64), size, reach, distance, weight)
    return distance, weight


@njit(**PARALLEL)  # type: ignore[misc, unused-ignore]
def _fuse(depths, T_cw, low, size, reach, distance, weight):  # type: ignore[no-untyped-def]
    views, height, width = depths.shape
    nx, ny, nz = distance.shape
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                x, y, z = low[0] + size * i, low[1] + size * j, low[2] + size * k
                total, sum_weight = 0.0, 0.0
                for v in range(views):
                    T = T_cw[v]
                    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
                    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
                    c = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
                    flat = a * a + c * c
                    far = math.sqrt(flat + b * b)
                    if far < 1e-6:
                        continue
                    column = int(width * (0.5 + math.atan2(a, c) / (2.0 * math.pi)))
                    row = int(height * (0.5 + math.atan2(b, math.sqrt(flat)) / math.pi))
                    depth = depths[v, min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
                    ahead = depth - far
                    if not ahead > -reach:  # hidden, or not known
                        continue
                    w = 1.0 / far
                    total += w * min(1.0, ahead / reach)
                    sum_weight += w
                if sum_weight > 0.0:
                    distance[i, j, k] = total / sum_weight
                    weight[i, j, k] = sum_weight

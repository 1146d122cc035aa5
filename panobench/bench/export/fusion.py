"""Depths of panoramas fused into a grid of truncated signed distances, along the rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange

Float = NDArray[np.float32]

_HALF, _PER_TURN = np.float32(0.5), np.float32(0.5 / np.pi)


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
    _fuse(
        np.ascontiguousarray(depths, np.float32), T_cw, np.asarray(low, np.float64), float(size), np.float32(reach),
        distance, weight,
    )  # fmt: skip
    return distance, weight


@njit(**JIT_FINITE)
def _look_up(a, b, c, step, width, height, far, index):  # type: ignore[no-untyped-def]
    """Write the distances of a row of voxels (N,), and the pixels of a flat panorama that show them.

    a, b, c: the first voxel in the camera's frame; step (3,): from each to the next.
    """
    w, h = np.float32(width), np.float32(height)
    for k in range(len(far)):
        n = np.float32(k)
        x, y, z = a + n * step[0], b + n * step[1], c + n * step[2]
        flat = np.sqrt(x * x + z * z)
        far[k] = np.sqrt(flat * flat + y * y)
        u = w * (_HALF + atan2_fast(x, z) * _PER_TURN)
        v = h * (_HALF + np.float32(2) * atan2_fast(y, flat) * _PER_TURN)
        column = np.int32(min(max(u, np.float32(0)), w - np.float32(1)))
        index[k] = np.int32(min(max(v, np.float32(0)), h - np.float32(1))) * np.int32(width) + column


@njit(**JIT)
def _add(depth, far, index, reach, total, weight):  # type: ignore[no-untyped-def]
    """Add what a flat panorama of depth says about a row of voxels (N,)."""
    for k in range(len(far)):
        ahead = depth[index[k]] - far[k]
        told = ahead > -reach and far[k] > np.float32(1e-6)  # not so where hidden, or not known
        w = np.float32(1) / far[k] if told else np.float32(0)
        total[k] += w * min(np.float32(1), ahead / reach) if told else np.float32(0)
        weight[k] += w


@njit(**PARALLEL)
def _fuse(depths, T_cw, low, size, reach, distance, weight):  # type: ignore[no-untyped-def]
    views, height, width = depths.shape
    nx, ny, nz = distance.shape
    for i in prange(nx):
        far, index, total = np.empty(nz, np.float32), np.empty(nz, np.uint32), np.empty(nz, np.float32)
        first, step = np.empty(3, np.float32), np.empty(3, np.float32)
        for j in range(ny):
            total[:] = 0
            for v in range(views):
                T = T_cw[v]
                for r in range(3):
                    x, y = low[0] + size * i, low[1] + size * j
                    first[r] = T[r, 0] * x + T[r, 1] * y + T[r, 2] * low[2] + T[r, 3]
                    step[r] = T[r, 2] * size
                _look_up(first[0], first[1], first[2], step, width, height, far, index)
                _add(depths[v].reshape(-1), far, index, reach, total, weight[i, j])
            for k in range(nz):
                if weight[i, j, k] > 0:
                    distance[i, j, k] = total[k] / weight[i, j, k]

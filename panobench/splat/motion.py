"""Moving Gaussians by similarities, one for each group of them: a loop closure bends a map so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, quaternion_from_matrix
from panobench.kernels.jit import JIT, PARALLEL, njit, prange
from panobench.splat.algebra import rotate, rotation
from panobench.splat.gaussians import GaussianMap

#: Columns of a motion: scale and its logarithm, rotation (w, x, y, z), translation.
_SCALE, _LOG, _Q, _T, _COLUMNS = 0, 1, 2, 6, 9


def move(gaussians: GaussianMap, groups: NDArray[np.int32], motions: Sequence[Sim3]) -> None:
    """Move each of N Gaussians, in place, by the motion (old world to new world) of its group (N,)."""
    table = np.zeros((len(motions), _COLUMNS))
    table[:, _SCALE] = [m.scale for m in motions]
    table[:, _LOG] = np.log(table[:, _SCALE])
    table[:, _Q:_T] = quaternion_from_matrix(np.stack([m.R for m in motions]))
    table[:, _T:] = [m.t for m in motions]
    means, log_scales, quats = (np.array(a) for a in (gaussians.means, gaussians.log_scales, gaussians.quats))
    _move(groups, table, means, log_scales, quats)
    gaussians.update(means=means, log_scales=log_scales, quats=quats)


@njit(**JIT)
def _multiply(a, b):  # type: ignore[no-untyped-def]
    """The product of two quaternions (w, x, y, z): the rotation b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit(**PARALLEL)
def _move(groups, table, means, log_scales, quats):  # type: ignore[no-untyped-def]
    """Move the rows of means (N, 3), log_scales (N, 3) and quats (N, 4), in place."""
    for k in prange(len(groups)):
        m = table[groups[k]]
        q = (m[_Q], m[_Q + 1], m[_Q + 2], m[_Q + 3])
        R, _ = rotation(q)
        moved = rotate(R, (means[k, 0], means[k, 1], means[k, 2]))
        turned = _multiply(q, (quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3]))
        for i in range(3):
            means[k, i] = m[_SCALE] * moved[i] + m[_T + i]
            log_scales[k, i] += m[_LOG]
        for i in range(4):
            quats[k, i] = turned[i]

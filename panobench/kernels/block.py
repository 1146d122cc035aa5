"""Blocks of Gaussians: BLOCK of them side by side in one flat buffer, one channel after the other.

Channel c of the Gaussian in slot j is at ``buf[j + c * BLOCK]``. Kernels work on blocks because a loop over slots is
vectorised; a loop over the map's arrays, which have a row per Gaussian, is not. Channels have the names of columns: the
y of the mean in slot j is ``buf[j + P.mean[1]]``.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from panobench.kernels.columns import PARAMETER, FootprintColumns, MomentColumns, ParameterColumns
from panobench.kernels.jit import INLINE, njit

#: Gaussians in a block.
BLOCK = 64

Columns = TypeVar("Columns", ParameterColumns, FootprintColumns, MomentColumns)


def channels(first: int, count: int) -> tuple[np.uint64, ...]:
    """Offsets of ``count`` channels after ``first`` others. They are unsigned: no check for a negative index."""
    return tuple(np.uint64(BLOCK * (first + k)) for k in range(count))


def offsets(columns: Columns, first: int) -> Columns:
    """The same names for offsets in a buffer in which these columns are the channels after ``first`` others."""

    def offset(value: Any) -> Any:
        return tuple(map(offset, value)) if isinstance(value, tuple) else np.uint64(BLOCK * (first + value))

    return type(columns)(*map(offset, columns))


#: The parameters come first in every buffer.
P = offsets(PARAMETER, 0)


@njit(**INLINE)
def load_parameters(buf, j, k, means, log_scales, quats, logits, colours):  # type: ignore[no-untyped-def]
    """Copy the parameters of Gaussian k of the map's arrays (shapes as in ``GaussianMap``) into slot j."""
    for i in range(3):
        buf[j + P.mean[i]], buf[j + P.log_scale[i]], buf[j + P.colour[i]] = means[k, i], log_scales[k, i], colours[k, i]
    for i in range(4):
        buf[j + P.quat[i]] = quats[k, i]
    buf[j + P.logit] = logits[k]


@njit(**INLINE)
def load3(buf, j, at):  # type: ignore[no-untyped-def]
    """The vector at offsets ``at`` (3) of slot j."""
    return buf[j + at[0]], buf[j + at[1]], buf[j + at[2]]


@njit(**INLINE)
def load4(buf, j, at):  # type: ignore[no-untyped-def]
    """The quaternion at offsets ``at`` (4) of slot j."""
    return buf[j + at[0]], buf[j + at[1]], buf[j + at[2]], buf[j + at[3]]


@njit(**INLINE)
def store3(buf, j, at, v):  # type: ignore[no-untyped-def]
    """Write the vector v to offsets ``at`` (3) of slot j."""
    buf[j + at[0]], buf[j + at[1]], buf[j + at[2]] = v


@njit(**INLINE)
def store4(buf, j, at, q):  # type: ignore[no-untyped-def]
    """Write the quaternion q to offsets ``at`` (4) of slot j."""
    buf[j + at[0]], buf[j + at[1]], buf[j + at[2]], buf[j + at[3]] = q

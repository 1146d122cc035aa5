"""Luma images, and their pyramids by averages of 2 x 2 pixels.

A render and a frame that are to be compared must be reduced by the same filter: a smaller render is not the same
image. Invalid pixels are NaN and stay out of every average.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import PARALLEL, njit, prange

F32 = NDArray[np.float32]


@njit(**PARALLEL)
def _luma_u8(image, valid, out):  # type: ignore[no-untyped-def]
    """Luma of Rec. 601, as in ``_luma_planes``."""
    for y in prange(image.shape[0]):
        for x in range(image.shape[1]):
            if valid[y, x]:
                s = 0.299 * image[y, x, 0] + 0.587 * image[y, x, 1] + 0.114 * image[y, x, 2]
                out[y, x] = np.float32(s / 255.0)
            else:
                out[y, x] = np.float32(np.nan)


@njit(**PARALLEL)
def _luma_planes(planes, out):  # type: ignore[no-untyped-def]
    for y in prange(planes.shape[1]):
        for x in range(planes.shape[2]):
            out[y, x] = (
                np.float32(0.299) * planes[0, y, x]
                + np.float32(0.587) * planes[1, y, x]
                + np.float32(0.114) * planes[2, y, x]
            )


def luma_of_frame(image: NDArray[np.uint8], valid: NDArray[np.bool_]) -> F32:
    """RGB (H, W, 3) uint8 -> luma (H, W) float32 in 0..1, NaN where not ``valid`` (H, W)."""
    out = np.empty(image.shape[:2], np.float32)
    _luma_u8(np.ascontiguousarray(image), valid, out)
    return out


def luma_of_planes(planes: F32) -> F32:
    """Colour planes (3, H, W) of a render -> luma (H, W) float32, of 1."""
    out = np.empty(planes.shape[1:], np.float32)
    _luma_planes(planes, out)
    return out


@njit(**PARALLEL)
def halve(image):  # type: ignore[no-untyped-def]
    """(H, W) -> (H // 2, W // 2): the mean of the known pixels of each block of 2 x 2; NaN if fewer than three are."""
    h, w = image.shape[0] // 2, image.shape[1] // 2
    out = np.empty((h, w), np.float32)
    for y in prange(h):
        for x in range(w):
            s, n = np.float32(0.0), 0
            for dy in range(2):
                for dx in range(2):
                    v = image[2 * y + dy, 2 * x + dx]
                    if v == v:
                        s += v
                        n += 1
            out[y, x] = s / n if n >= 3 else np.float32(np.nan)
    return out


def pyramid(image: F32, smallest_width: int = 64) -> list[F32]:
    """Images by level: level 0 is ``image`` (H, W), then halved while the width stays at least ``smallest_width``."""
    levels = [image]
    while levels[-1].shape[1] // 2 >= smallest_width and levels[-1].shape[0] % 2 == 0:
        levels.append(halve(levels[-1]))
    return levels

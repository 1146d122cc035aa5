"""Row bounds: which pixel rows a footprint reaches within one column of tiles.

The rectangle around a slanted or curved footprint is mostly empty, and compositing costs time for every pixel that is
visited. A footprint is the cone r^T Q r <= 0 with Q = p1 p1^T + p2 p2^T - q m m^T and q the footprint's cut
(``FootprintColumns``). Take the plane that touches the sphere along the middle meridian of a column of tiles,
r = a + X x + Y y, with a the horizontal ray to that meridian, x east and y down. On it meridians are the lines
X = const, and the footprint is an ellipse whose highest and lowest points between two meridians have a closed form. A
parallel is a hyperbola there, y / |r| = Y / sqrt(1 + X^2 + Y^2); over the width of a tile it bends by less than a
pixel, which the bounds allow for. In a pinhole image X and Y are pixel coordinates up to scale, and nothing bends.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.block import BLOCK, channels, load3
from panobench.kernels.columns import CAM
from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import INLINE, JIT, njit
from panobench.splat.view import BOUND_LATLON

# Offsets in a block's buffer: the footprint; x and z of the directions a and x of its column, which have no y; and the
# first and last row that it reaches.
_P1, _P2, _M = channels(0, 3), channels(3, 3), channels(6, 3)
_CUT, _AX, _AZ, _XX, _XZ, _FIRST, _LAST = channels(9, 7)
_CHANNELS = 16
#: Slack for rounding, in pixels.
_SLACK = np.float32(0.02)
#: An ellipse whose det / (Qxx Qyy) is smaller is too thin for float32, and is bounded by its rectangle alone.
_THIN = np.float32(1e-4)
_F0, _F1, _HALF, _INV_PI = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(1.0 / np.pi)
#: Beyond every image.
_FAR = np.float32(1e6)


@njit(**INLINE)
def _lowest_and_highest(Qaa, Qax, Qxx, Qay, Qxy, Qyy, half):  # type: ignore[no-untyped-def]
    """Least and largest Y of Qaa + 2 Qax X + Qxx X^2 + 2 (Qay + Qxy X) Y + Qyy Y^2 <= 0 within |X| <= half.

    Where nothing is left the least exceeds the largest; where this is no ellipse there is no bound.
    """
    det = Qxx * Qyy - Qxy * Qxy
    ellipse = (Qxx > _F0) & (Qyy > _F0) & (det > _THIN * Qxx * Qyy)
    inv_det, inv = _F1 / (det if ellipse else _F1), _F1 / (Qyy if ellipse else _F1)
    # A quarter of the discriminant in Y is d0 + 2 d1 X - det X^2; its roots are the left and right end of the ellipse.
    d0, d1 = Qay * Qay - Qyy * Qaa, Qay * Qxy - Qyy * Qax
    middle = d1 * inv_det
    wide = np.sqrt(max(middle * middle + d0 * inv_det, _F0))
    left, right = max(-half, middle - wide), min(half, middle + wide)
    # The extreme Y lie at equal distances from the middle, or at the bound on X that is nearest to them.
    aside = -Qxy * wide / np.sqrt(Qxx * Qyy if ellipse else _F1)
    low, high = min(max(middle - aside, left), right), min(max(middle + aside, left), right)
    root_low = np.sqrt(max(d0 + low * (d1 + d1 - det * low), _F0))
    root_high = np.sqrt(max(d0 + high * (d1 + d1 - det * high), _F0))
    least, largest = -(Qay + low * Qxy + root_low) * inv, (root_high - Qay - high * Qxy) * inv
    some = left <= right
    return (
        (least if some else _FAR) if ellipse else -_FAR,
        (largest if some else -_FAR) if ellipse else _FAR,
    )


@njit(**INLINE)
def _bounds(buf, j, half):  # type: ignore[no-untyped-def]
    """Least and largest Y of the footprint in slot j within its column of tiles."""
    ax, az, xx, xz = buf[j + _AX], buf[j + _AZ], buf[j + _XX], buf[j + _XZ]
    p1x, p1y, p1z = load3(buf, j, _P1)
    p2x, p2y, p2z = load3(buf, j, _P2)
    mx, my, mz = load3(buf, j, _M)
    p1a, p2a, ma = p1x * ax + p1z * az, p2x * ax + p2z * az, mx * ax + mz * az
    p1x, p2x, mx = p1x * xx + p1z * xz, p2x * xx + p2z * xz, mx * xx + mz * xz
    qa, qx, qy = buf[j + _CUT] * ma, buf[j + _CUT] * mx, buf[j + _CUT] * my
    return _lowest_and_highest(
        p1a * p1a + p2a * p2a - qa * ma,
        p1a * p1x + p2a * p2x - qa * mx,
        p1x * p1x + p2x * p2x - qx * mx,
        p1a * p1y + p2a * p2y - qa * my,
        p1x * p1y + p2x * p2y - qx * my,
        p1y * p1y + p2y * p2y - qy * my,
        half,
    )


@njit(**JIT)
def _rows_latlon(buf, n, half, H):  # type: ignore[no-untyped-def]
    """First and last row, as floats, in a panorama of H rows."""
    bend = _F1 / np.sqrt(_F1 + half * half)
    for j in range(np.uint64(n)):
        least, largest = _bounds(buf, j, half)
        least, largest = least * (_F1 if least < _F0 else bend), largest * (bend if largest < _F0 else _F1)
        buf[j + _FIRST] = H * (atan2_fast(least, _F1) * _INV_PI + _HALF)
        buf[j + _LAST] = H * (atan2_fast(largest, _F1) * _INV_PI + _HALF)


@njit(**JIT)
def _rows_pinhole(buf, n, half, fy, cy):  # type: ignore[no-untyped-def]
    """First and last row, as floats, in a pinhole image."""
    for j in range(np.uint64(n)):
        least, largest = _bounds(buf, j, half)
        buf[j + _FIRST], buf[j + _LAST] = fy * least + cy, fy * largest + cy


@njit(**JIT)
def row_bounds(which, columns, footprints, rows, bound, axes, half, intr, first, last):  # type: ignore[no-untyped-def]
    """Write the first and last pixel row (S,) int32 of footprints ``which`` (S,) in columns of tiles ``columns`` (S,).

    ``first`` exceeds ``last`` where a footprint misses a column. footprints, rows: as ``project`` writes them; axes
    (tiles_x, 4), half: ``View.column_axes`` and ``View.column_half``; bound, intr: the view's.
    """
    buf = np.empty(_CHANNELS * BLOCK, np.float32)
    H = np.float32(intr[CAM.height])
    for s0 in range(0, len(which), BLOCK):
        n = min(BLOCK, len(which) - s0)
        for j in range(n):
            k, c = which[s0 + j], columns[s0 + j]
            for i in range(3):
                buf[j + _P1[i]], buf[j + _P2[i]] = footprints[k, F.p1[i]], footprints[k, F.p2[i]]
                buf[j + _M[i]] = footprints[k, F.m[i]]
            buf[j + _CUT] = footprints[k, F.cut]
            buf[j + _AX], buf[j + _AZ], buf[j + _XX], buf[j + _XZ] = axes[c, 0], axes[c, 1], axes[c, 2], axes[c, 3]
        if bound == BOUND_LATLON:
            _rows_latlon(buf, n, half, H)
        else:
            _rows_pinhole(buf, n, half, np.float32(intr[CAM.fy]), np.float32(intr[CAM.cy]))
        for j in range(n):
            k = which[s0 + j]
            low, high = max(buf[j + _FIRST], -_F1), min(buf[j + _LAST], H + _F1)
            first[s0 + j] = max(int(np.ceil(low - _HALF - _SLACK)), rows[k, 0])
            last[s0 + j] = min(int(np.floor(high - _HALF + _SLACK)), rows[k, 1])

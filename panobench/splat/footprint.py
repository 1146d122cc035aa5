"""Footprints on the sphere, a block of Gaussians at a time, and the rectangles of pixels that hold them.

The exact tangent-plane footprint of project.py; what bounds it depends on the camera.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from panobench.photometric.warp import atan2_fast
from panobench.splat.algebra import (
    axes_in_camera,
    camera_covariance,
    dot,
    exp_fast,
    log_fast,
    rotate,
    symmetric_times,
    tangent_basis,
    whiten,
)
from panobench.splat.block import PARAMETERS, P, channels
from panobench.splat.kernel_options import ALPHA_MIN, COS_MIN, INLINE, JIT
from panobench.splat.view import BOUND_FLAT, BOUND_LATLON

#: Largest tangent offset of a footprint: further out m.r < COS_MIN and nothing is drawn.
OFFSET_MAX = float(np.sqrt(1.0 / COS_MIN**2 - 1.0))

# Offsets in a block's buffer behind the parameters; the names are those of the packed columns (see project).
_P1, _P2, _MU = channels(PARAMETERS, 3), channels(PARAMETERS + 3, 3), channels(PARAMETERS + 6, 3)
_SPREAD, _SLOPE, _REACH = channels(PARAMETERS + 9, 3), channels(PARAMETERS + 12, 2), channels(PARAMETERS + 14, 2)
_BOX = channels(PARAMETERS + 16, 4)  # south, north, half width, longitude
_O, _DIST, _CUT, _SEEN = channels(PARAMETERS + 20, 4)
#: Channels up to here.
FOOTPRINT_CHANNELS = PARAMETERS + 24

_F0, _F1, _F2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_PI, _POLE = np.float32(np.pi), np.float32(0.5 * np.pi - 1e-3)
_TINY, _HUGE, _INV_ALPHA_MIN = np.float32(1e-6), np.float32(1e20), np.float32(1.0 / ALPHA_MIN)


@njit(**INLINE)
def latlon_extent(m, reach_e, reach_s, reach):  # type: ignore[no-untyped-def]
    """Southern and northern latitude and half width in longitude of a footprint (pi: the whole row), float32.

    reach_e, reach_s: largest tangent offsets to the east and south; reach: angular radius. The corners of the
    tangent rectangle m + e de + s ds bound every footprint that stays clear of the poles. Angles are good to
    3e-7 rad; footprint bounds carry far more slack than that.
    """
    sin_lat, cos_lat = -m[1], np.sqrt(m[0] * m[0] + m[2] * m[2])
    lat = atan2_fast(sin_lat, cos_lat)
    up, down = sin_lat + reach_s * cos_lat, sin_lat - reach_s * cos_lat
    h_up, h_down = cos_lat - reach_s * sin_lat, cos_lat + reach_s * sin_lat
    north = atan2_fast(up, h_up if up >= _F0 else np.sqrt(h_up * h_up + reach_e * reach_e))
    south = atan2_fast(down, h_down if down <= _F0 else np.sqrt(h_down * h_down + reach_e * reach_e))
    half = atan2_fast(reach_e, min(h_up, h_down))
    # Over a pole, or with a rectangle that reaches behind one.
    polar = (abs(lat) + reach >= _POLE) | (h_up <= _TINY) | (h_down <= _TINY)
    return (
        lat - reach if polar else max(south, lat - reach),
        lat + reach if polar else min(north, lat + reach),
        _PI if polar else half,
    )


@njit(**JIT)
def flat_extent(m, e, s, Q00, Q01, Q11, A22, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """First and last pixel column (axis 0) or row (1) of a footprint wholly in front of a pinhole camera.

    The planes x = t z through the eye that touch the ellipse m + E^T d, d^T Q^-1 d = 1, are the roots of
    n^T (m m^T - E^T Q E) n = 0 with n = (1, 0, -t).
    """
    A00 = m[axis] * m[axis] - (Q00 * e[axis] * e[axis] + 2.0 * Q01 * e[axis] * s[axis] + Q11 * s[axis] * s[axis])
    A02 = m[axis] * m[2] - (Q00 * e[axis] * e[2] + Q01 * (e[axis] * s[2] + s[axis] * e[2]) + Q11 * s[axis] * s[2])
    root = np.sqrt(max(A02 * A02 - A00 * A22, 0.0))
    low, high = focal * (A02 - root) / A22 + centre, focal * (A02 + root) / A22 + centre
    first = int(np.ceil(min(max(low, -1.0), size + 1.0) - 0.5 - 1e-3))
    last = int(np.floor(min(max(high, -1.0), size + 1.0) - 0.5 + 1e-3))
    return max(first, 0), min(last, int(size) - 1)


@njit(**JIT)
def side_extent(m, reach, sin_reach, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """As ``flat_extent`` for a cone that reaches behind the camera: planes through the eye at angle phi +- half."""
    h = np.sqrt(m[axis] * m[axis] + m[2] * m[2])
    if h <= sin_reach:
        return 0, int(size) - 1
    phi, half = np.arctan2(m[axis], m[2]), np.arcsin(min(sin_reach / h, 1.0)) + 1e-4
    low, high = phi - half, phi + half
    edge = 0.5 * np.pi - 1e-3
    first, last = 0, int(size) - 1
    if low >= edge or high <= -edge:
        return 1, 0
    if low > -edge:
        first = max(int(np.ceil(min(max(focal * np.tan(low) + centre, -1.0), size + 1.0) - 0.5)), 0)
    if high < edge:
        last = min(int(np.floor(min(max(focal * np.tan(high) + centre, -1.0), size + 1.0) - 0.5)), int(size) - 1)
    return first, last


@njit(inline="always", **JIT)
def sphere_block(buf, n, R, t, near, low, sloped, latlon):  # type: ignore[no-untyped-def]
    """Tangent-plane footprints of the n Gaussians whose parameters are in the buffer."""
    for j in range(np.uint64(n)):
        turned = rotate(R, (float(buf[j + P[0]]), float(buf[j + P[1]]), float(buf[j + P[2]])))
        mu = (turned[0] + t[0], turned[1] + t[1], turned[2] + t[2])
        dist = np.sqrt(dot(mu, mu))
        seen = (dist >= near) & (dist < 1e9)
        inv = 1.0 / dist if seen else 1.0
        o = _F1 / (_F1 + exp_fast(-buf[j + P[10]]))
        q_cut = _F2 * log_fast(o * _INV_ALPHA_MIN)
        q = (buf[j + P[6]], buf[j + P[7]], buf[j + P[8]], buf[j + P[9]])
        C = camera_covariance(axes_in_camera(q, (buf[j + P[3]], buf[j + P[4]], buf[j + P[5]]), R))
        m = (mu[0] * inv, mu[1] * inv, mu[2] * inv)
        e, s = tangent_basis(m)
        Ce, Cs = symmetric_times(C, e), symmetric_times(C, s)
        inv2 = inv * inv
        S00, S01, S11 = dot(e, Ce) * inv2 + low, dot(s, Ce) * inv2, dot(s, Cs) * inv2 + low
        w00, w01, w11 = whiten(S00, S01, S11)
        buf[j + _P1[0]], buf[j + _P1[1]], buf[j + _P1[2]] = w00 * e[0] + w01 * s[0], w01 * s[1], w00 * e[2] + w01 * s[2]
        buf[j + _P2[0]], buf[j + _P2[1]], buf[j + _P2[2]] = w11 * s[0], w11 * s[1], w11 * s[2]
        buf[j + _MU[0]], buf[j + _MU[1]], buf[j + _MU[2]] = m
        ce, cs = dot(m, Ce) * inv, dot(m, Cs) * inv
        buf[j + _SLOPE[0]], buf[j + _SLOPE[1]] = w00 * ce + w01 * cs if sloped else 0.0, w11 * cs if sloped else 0.0
        spread = 0.5 * (S00 + S11) + np.sqrt(max(0.25 * (S00 - S11) * (S00 - S11) + S01 * S01, 0.0))
        offset = min(np.sqrt(q_cut * spread), OFFSET_MAX)
        cos_reach = 1.0 / np.sqrt(1.0 + offset * offset)
        buf[j + _REACH[0]], buf[j + _REACH[1]] = cos_reach, offset * cos_reach
        buf[j + _O], buf[j + _DIST], buf[j + _CUT] = o, dist, q_cut
        buf[j + _SPREAD[0]], buf[j + _SPREAD[1]], buf[j + _SPREAD[2]] = S00, S01, S11
        # A NaN anywhere fails the comparison.
        buf[j + _SEEN] = _F1 if seen & (o > np.float32(ALPHA_MIN)) & (spread < _HUGE) else _F0
        if latlon:
            m32 = (np.float32(m[0]), np.float32(m[1]), np.float32(m[2]))
            reach_e, reach_s = np.float32(np.sqrt(q_cut * S00)), np.float32(np.sqrt(q_cut * S11))
            south, north, half = latlon_extent(m32, reach_e, reach_s, atan2_fast(np.float32(offset), _F1))
            buf[j + _BOX[0]], buf[j + _BOX[1]], buf[j + _BOX[2]] = south, north, half
            buf[j + _BOX[3]] = atan2_fast(m32[0], m32[2])


@njit(**JIT)
def _box_latlon(buf, j, W, H):  # type: ignore[no-untyped-def]
    """First and last row and column of the footprint in slot j; columns may run past an edge."""
    south, north, half, lon = buf[j + _BOX[0]], buf[j + _BOX[1]], buf[j + _BOX[2]], buf[j + _BOX[3]]
    r0 = max(int(np.ceil(H * (0.5 - north / np.pi) - 0.5 - 1e-3)), 0)
    r1 = min(int(np.floor(H * (0.5 - south / np.pi) - 0.5 + 1e-3)), int(H) - 1)
    if half >= _PI:
        return r0, r1, 0, int(W) - 1
    u, half = W * (0.5 + lon / (2 * np.pi)) - 0.5, half * W / (2 * np.pi) + 1e-3
    return r0, r1, int(np.ceil(u - half)), int(np.floor(u + half))


@njit(**JIT)
def _box_flat(buf, j, intr):  # type: ignore[no-untyped-def]
    """The same for a pinhole camera; an empty box behind it."""
    W, H = intr[0], intr[1]
    m = (float(buf[j + _MU[0]]), float(buf[j + _MU[1]]), float(buf[j + _MU[2]]))
    e, s = tangent_basis(m)
    q_cut = float(buf[j + _CUT])
    Q00, Q01, Q11 = q_cut * buf[j + _SPREAD[0]], q_cut * buf[j + _SPREAD[1]], q_cut * buf[j + _SPREAD[2]]
    A22 = m[2] * m[2] - (Q00 * e[2] * e[2] + 2.0 * Q01 * e[2] * s[2] + Q11 * s[2] * s[2])
    if A22 > 1e-6:
        if m[2] < 0.0:
            return 1, 0, 1, 0
        c0, c1 = flat_extent(m, e, s, Q00, Q01, Q11, A22, 0, intr[2], intr[4], W)
        r0, r1 = flat_extent(m, e, s, Q00, Q01, Q11, A22, 1, intr[3], intr[5], H)
    else:
        sin_reach = float(buf[j + _REACH[1]])
        reach = np.arctan2(sin_reach, float(buf[j + _REACH[0]]))
        c0, c1 = side_extent(m, reach, sin_reach, 0, intr[2], intr[4], W)
        r0, r1 = side_extent(m, reach, sin_reach, 1, intr[3], intr[5], H)
    return r0, r1, c0, c1


@njit(**JIT)
def store_block(buf, n, k0, bound, intr, colours, packed, rows, cols, key):  # type: ignore[no-untyped-def]
    """A block's footprints into the packed rows from k0 on."""
    W, H = intr[0], intr[1]
    for j in range(n):
        k = k0 + j
        key[k] = np.float32(-1.0)
        if buf[j + _SEEN] == _F0:
            continue
        if bound == BOUND_LATLON:
            box = _box_latlon(buf, j, W, H)
        elif bound == BOUND_FLAT:
            box = _box_flat(buf, j, intr)
        else:
            box = (0, int(H) - 1, 0, int(W) - 1)
        rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1] = box
        if box[1] < box[0] or box[3] < box[2]:
            continue
        for i in range(3):
            packed[k, i], packed[k, 3 + i], packed[k, 6 + i] = buf[j + _P1[i]], buf[j + _P2[i]], buf[j + _MU[i]]
            packed[k, 10 + i] = colours[k, i]
        packed[k, 9], packed[k, 13], packed[k, 14] = buf[j + _O], buf[j + _DIST], buf[j + _CUT]
        packed[k, 15], packed[k, 16], packed[k, 17] = _F0, buf[j + _REACH[0]], buf[j + _REACH[1]]
        packed[k, 18], packed[k, 19] = buf[j + _SLOPE[0]], buf[j + _SLOPE[1]]
        key[k] = buf[j + _DIST]

"""Footprints on the sphere, a block of Gaussians at a time, and the rectangles of pixels that bound them.

The footprint is the exact one on the tangent plane, see ``project``. How it is bounded depends on the camera: by
latitude and longitude in a panorama, by rows and columns in an undistorted pinhole image, by cones elsewhere.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.block import P, channels, load3, load4, offsets, store3
from panobench.kernels.columns import CAM, FOOTPRINT, FOOTPRINT_COLUMNS, PARAMETERS
from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.fast_math import atan2_fast, exp_fast, log_fast
from panobench.kernels.jit import INLINE, JIT, njit
from panobench.splat.algebra import (
    axes_in_camera,
    camera_covariance,
    dot,
    rotate,
    symmetric_times,
    tangent_basis,
    whiten,
)
from panobench.splat.view import BOUND_LATLON, BOUND_PINHOLE

#: An alpha below this counts as zero: one step of an 8-bit image.
ALPHA_MIN = 1.0 / 255.0
#: Cosine of the largest angle between a Gaussian's direction and a pixel that it may colour (about 84 degrees).
COS_MIN = 0.1
#: Largest tangent offset of a footprint: further out m.r < COS_MIN and nothing is drawn.
OFFSET_MAX = float(np.sqrt(1.0 / COS_MIN**2 - 1.0))

# Offsets in a block's buffer after the parameters: the footprint itself, then its covariance (00, 01, 11) in the
# tangent plane, its bounds (south, north, half width, longitude; radians), and whether it is drawn.
_FP = offsets(FOOTPRINT, PARAMETERS)
_COVARIANCE = channels(PARAMETERS + FOOTPRINT_COLUMNS, 3)
_SOUTH, _NORTH, _HALF_WIDTH, _LON, _SEEN = channels(PARAMETERS + FOOTPRINT_COLUMNS + 3, 5)
#: Channels up to here.
FOOTPRINT_CHANNELS = PARAMETERS + FOOTPRINT_COLUMNS + 8

_F0, _F1, _F2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_PI, _POLE = np.float32(np.pi), np.float32(0.5 * np.pi - 1e-3)
_TINY, _HUGE, _INV_ALPHA_MIN = np.float32(1e-6), np.float32(1e20), np.float32(1.0 / ALPHA_MIN)


@njit(**INLINE)
def latlon_extent(m, reach_e, reach_s, reach):  # type: ignore[no-untyped-def]
    """Southern and northern latitude and half width in longitude of a footprint, in radians (pi: the whole row).

    m: direction of the mean; reach_e, reach_s: largest tangent offsets to the east and south; reach: angular radius;
    all float32. The corners of the tangent rectangle m + e de + s ds bound every footprint that stays clear of the
    poles. The angles are good to 3e-7 rad, far better than the slack of the bounds.
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
def pinhole_extent(m, e, s, Q00, Q01, Q11, A22, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """First and last pixel column (axis 0) or row (axis 1) of a footprint wholly in front of a pinhole camera.

    The planes x = t z through the camera's centre that touch the ellipse m + E^T d, d^T Q^-1 d = 1, are the roots of
    n^T (m m^T - E^T Q E) n = 0 with n = (1, 0, -t). e, s: the rows of E. A22: entry zz of m m^T - E^T Q E. focal,
    centre, size: the camera's along the axis, in pixels.
    """
    A00 = m[axis] * m[axis] - (Q00 * e[axis] * e[axis] + 2.0 * Q01 * e[axis] * s[axis] + Q11 * s[axis] * s[axis])
    A02 = m[axis] * m[2] - (Q00 * e[axis] * e[2] + Q01 * (e[axis] * s[2] + s[axis] * e[2]) + Q11 * s[axis] * s[2])
    root = np.sqrt(max(A02 * A02 - A00 * A22, 0.0))
    low, high = focal * (A02 - root) / A22 + centre, focal * (A02 + root) / A22 + centre
    first = int(np.ceil(min(max(low, -1.0), size + 1.0) - 0.5 - 1e-3))
    last = int(np.floor(min(max(high, -1.0), size + 1.0) - 0.5 + 1e-3))
    return max(first, 0), min(last, int(size) - 1)


@njit(**JIT)
def cone_extent(m, reach, sin_reach, axis, focal, centre, size):  # type: ignore[no-untyped-def]
    """As ``pinhole_extent`` for a cone of angular radius ``reach`` that extends behind the camera.

    The planes through the camera's centre that touch it stand at angles phi +- half.
    """
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
    """Tangent-plane footprints of the n Gaussians whose parameters are in the buffer.

    R, t: world to camera; near: least distance; low: variance added to every footprint, rad^2; sloped: with slopes of
    the distance; latlon: with bounds in latitude and longitude.
    """
    for j in range(np.uint64(n)):
        x, y, z = load3(buf, j, P.mean)
        x, y, z = rotate(R, (float(x), float(y), float(z)))
        mu = (x + t[0], y + t[1], z + t[2])
        dist = np.sqrt(dot(mu, mu))
        seen = (dist >= near) & (dist < 1e9)
        inv = 1.0 / dist if seen else 1.0
        o = _F1 / (_F1 + exp_fast(-buf[j + P.logit]))
        q_cut = _F2 * log_fast(o * _INV_ALPHA_MIN)
        C = camera_covariance(axes_in_camera(load4(buf, j, P.quat), load3(buf, j, P.log_scale), R))
        m = (mu[0] * inv, mu[1] * inv, mu[2] * inv)
        e, s = tangent_basis(m)
        Ce, Cs = symmetric_times(C, e), symmetric_times(C, s)
        inv2 = inv * inv
        S00, S01, S11 = dot(e, Ce) * inv2 + low, dot(s, Ce) * inv2, dot(s, Cs) * inv2 + low
        w00, w01, w11 = whiten(S00, S01, S11)
        store3(buf, j, _FP.p1, (w00 * e[0] + w01 * s[0], w01 * s[1], w00 * e[2] + w01 * s[2]))
        store3(buf, j, _FP.p2, (w11 * s[0], w11 * s[1], w11 * s[2]))
        store3(buf, j, _FP.m, m)
        ce, cs = dot(m, Ce) * inv, dot(m, Cs) * inv
        buf[j + _FP.slope[0]] = w00 * ce + w01 * cs if sloped else 0.0
        buf[j + _FP.slope[1]] = w11 * cs if sloped else 0.0
        spread = 0.5 * (S00 + S11) + np.sqrt(max(0.25 * (S00 - S11) * (S00 - S11) + S01 * S01, 0.0))
        offset = min(np.sqrt(q_cut * spread), OFFSET_MAX)
        cos_reach = 1.0 / np.sqrt(1.0 + offset * offset)
        buf[j + _FP.cos_radius], buf[j + _FP.sin_radius] = cos_reach, offset * cos_reach
        buf[j + _FP.opacity], buf[j + _FP.distance], buf[j + _FP.cut] = o, dist, q_cut
        store3(buf, j, _COVARIANCE, (S00, S01, S11))
        # A NaN anywhere fails one of the comparisons.
        buf[j + _SEEN] = _F1 if seen & (o > np.float32(ALPHA_MIN)) & (spread < _HUGE) else _F0
        if latlon:
            m32 = (np.float32(m[0]), np.float32(m[1]), np.float32(m[2]))
            reach_e, reach_s = np.float32(np.sqrt(q_cut * S00)), np.float32(np.sqrt(q_cut * S11))
            south, north, half = latlon_extent(m32, reach_e, reach_s, atan2_fast(np.float32(offset), _F1))
            buf[j + _SOUTH], buf[j + _NORTH], buf[j + _HALF_WIDTH] = south, north, half
            buf[j + _LON] = atan2_fast(m32[0], m32[2])


@njit(**JIT)
def _box_latlon(buf, j, W, H):  # type: ignore[no-untyped-def]
    """First and last row and column of slot j's footprint in a panorama; columns may run past either edge."""
    south, north, half, lon = buf[j + _SOUTH], buf[j + _NORTH], buf[j + _HALF_WIDTH], buf[j + _LON]
    r0 = max(int(np.ceil(H * (0.5 - north / np.pi) - 0.5 - 1e-3)), 0)
    r1 = min(int(np.floor(H * (0.5 - south / np.pi) - 0.5 + 1e-3)), int(H) - 1)
    if half >= _PI:
        return r0, r1, 0, int(W) - 1
    u, half = W * (0.5 + lon / (2 * np.pi)) - 0.5, half * W / (2 * np.pi) + 1e-3
    return r0, r1, int(np.ceil(u - half)), int(np.floor(u + half))


@njit(**JIT)
def _box_pinhole(buf, j, intr):  # type: ignore[no-untyped-def]
    """First and last row and column of slot j's footprint in a pinhole image; last before first behind the camera."""
    W, H = intr[CAM.width], intr[CAM.height]
    x, y, z = load3(buf, j, _FP.m)
    m = (float(x), float(y), float(z))
    e, s = tangent_basis(m)
    q_cut = float(buf[j + _FP.cut])
    S00, S01, S11 = load3(buf, j, _COVARIANCE)
    Q00, Q01, Q11 = q_cut * S00, q_cut * S01, q_cut * S11
    A22 = m[2] * m[2] - (Q00 * e[2] * e[2] + 2.0 * Q01 * e[2] * s[2] + Q11 * s[2] * s[2])
    if A22 > 1e-6:
        if m[2] < 0.0:
            return 1, 0, 1, 0
        c0, c1 = pinhole_extent(m, e, s, Q00, Q01, Q11, A22, 0, intr[CAM.fx], intr[CAM.cx], W)
        r0, r1 = pinhole_extent(m, e, s, Q00, Q01, Q11, A22, 1, intr[CAM.fy], intr[CAM.cy], H)
    else:
        sin_reach = float(buf[j + _FP.sin_radius])
        reach = np.arctan2(sin_reach, float(buf[j + _FP.cos_radius]))
        c0, c1 = cone_extent(m, reach, sin_reach, 0, intr[CAM.fx], intr[CAM.cx], W)
        r0, r1 = cone_extent(m, reach, sin_reach, 1, intr[CAM.fy], intr[CAM.cy], H)
    return r0, r1, c0, c1


@njit(**JIT)
def store_block(buf, n, k0, bound, intr, footprints, rows, cols, key):  # type: ignore[no-untyped-def]
    """Write a block's n footprints to rows k0 .. k0 + n - 1 of ``footprints``, ``rows``, ``cols`` and ``key``.

    See ``project`` for these arrays. A Gaussian that is not seen keeps a key of -1.
    """
    W, H = intr[CAM.width], intr[CAM.height]
    for j in range(n):
        k = k0 + j
        key[k] = np.float32(-1.0)
        if buf[j + _SEEN] == _F0:
            continue
        if bound == BOUND_LATLON:
            box = _box_latlon(buf, j, W, H)
        elif bound == BOUND_PINHOLE:
            box = _box_pinhole(buf, j, intr)
        else:
            box = (0, int(H) - 1, 0, int(W) - 1)
        rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1] = box
        if box[1] < box[0] or box[3] < box[2]:
            continue
        for i in range(3):
            footprints[k, F.p1[i]], footprints[k, F.p2[i]] = buf[j + _FP.p1[i]], buf[j + _FP.p2[i]]
            footprints[k, F.m[i]], footprints[k, F.colour[i]] = buf[j + _FP.m[i]], buf[j + P.colour[i]]
        footprints[k, F.opacity], footprints[k, F.cut], footprints[k, F.u] = buf[j + _FP.opacity], buf[j + _FP.cut], _F0
        footprints[k, F.cos_radius], footprints[k, F.sin_radius] = buf[j + _FP.cos_radius], buf[j + _FP.sin_radius]
        footprints[k, F.slope[0]], footprints[k, F.slope[1]] = buf[j + _FP.slope[0]], buf[j + _FP.slope[1]]
        footprints[k, F.distance] = key[k] = buf[j + _FP.distance]

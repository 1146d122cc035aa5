"""exp, log and atan2 in float32 without branches or library calls, so that loops which use them are vectorised."""

from __future__ import annotations

import numpy as np

from panobench.kernels.jit import INLINE, njit

_LOG2E, _LN2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_PI, _HALF_PI = np.float32(np.pi), np.float32(np.pi / 2)
_E3, _E4, _E5 = np.float32(1.6666665459e-1), np.float32(4.1665795894e-2), np.float32(8.3334519073e-3)
_E6, _E7 = np.float32(1.3981999507e-3), np.float32(1.9875691500e-4)
_L0, _L1, _L2 = np.float32(7.0376836292e-2), np.float32(-1.1514610310e-1), np.float32(1.1676998740e-1)
_L3, _L4, _L5 = np.float32(-1.2420140846e-1), np.float32(1.4249322787e-1), np.float32(-1.6668057665e-1)
_L6, _L7, _L8 = np.float32(2.0000714765e-1), np.float32(-2.4999993993e-1), np.float32(3.3333331174e-1)
_SQRT2 = np.float32(1.4142135623730951)


@njit(**INLINE)
def exp_fast(x):  # type: ignore[no-untyped-def]
    """exp of a float32, clamped to [-80, 80]; relative error below 1e-6 (coefficients: Cephes, expf.c)."""
    x = min(max(x, np.float32(-80.0)), np.float32(80.0))
    n = np.floor(x * _LOG2E + _HALF)
    f = x - n * _LN2
    p = ((((_E7 * f + _E6) * f + _E5) * f + _E4) * f + _E3) * f + _HALF
    power = np.int32((np.int32(n) + np.int32(127)) << np.int32(23))
    return (p * f * f + f + _ONE) * power.view(np.float32)


@njit(**INLINE)
def log_fast(x):  # type: ignore[no-untyped-def]
    """log of a positive, normal float32; absolute error below 1e-6 (coefficients: Cephes, logf.c)."""
    bits = np.float32(x).view(np.int32)
    e = (bits >> np.int32(23)) - np.int32(127)
    m = np.int32((bits & np.int32(0x7FFFFF)) | np.int32(0x3F800000)).view(np.float32)
    big = m > _SQRT2
    e, m = np.float32(e + np.int32(1) if big else e), (_HALF * m if big else m) - _ONE
    p = ((_L0 * m + _L1) * m + _L2) * m + _L3
    p = ((((p * m + _L4) * m + _L5) * m + _L6) * m + _L7) * m + _L8
    return p * m * m * m - _HALF * m * m + m + e * _LN2


@njit(**INLINE)
def atan2_fast(y, x):  # type: ignore[no-untyped-def]
    """atan2 in radians of two float32, absolute error below 3e-7 (odd polynomial, minimax fit on [0, 1])."""
    ax, ay = abs(x), abs(y)
    top, bottom = min(ax, ay), max(ax, ay)
    a = top / max(bottom, np.float32(1e-30))
    s = a * a
    r = np.float32(0.00681177) * s - np.float32(0.03360415)
    r = r * s + np.float32(0.0796236)
    r = r * s - np.float32(0.13233339)
    r = r * s + np.float32(0.19807815)
    r = r * s - np.float32(0.33317368)
    r = (r * s + np.float32(0.99999611)) * a
    if ay > ax:
        r = _HALF_PI - r
    if x < 0:
        r = _PI - r
    return -r if y < 0 else r

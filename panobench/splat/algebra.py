"""Small vectors and matrices as tuples of floats: arrays would be heap allocations, millions a second.

Everything here is free of branches and of calls LLVM cannot vectorise, so that kernels may loop over a block of
Gaussians (see kernel_options.BLOCK) several at a time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from panobench.splat.kernel_options import INLINE

_LOG2E, _LN2 = np.float32(1.4426950408889634), np.float32(0.6931471805599453)
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_E3, _E4, _E5 = np.float32(1.6666665459e-1), np.float32(4.1665795894e-2), np.float32(8.3334519073e-3)
_L0, _L1, _L2 = np.float32(7.0376836292e-2), np.float32(-1.1514610310e-1), np.float32(1.1676998740e-1)
_L3, _L4, _L5 = np.float32(-1.2420140846e-1), np.float32(1.4249322787e-1), np.float32(-1.6668057665e-1)
_L6, _L7, _L8 = np.float32(2.0000714765e-1), np.float32(-2.4999993993e-1), np.float32(3.3333331174e-1)
_SQRT2 = np.float32(1.4142135623730951)
_E6, _E7 = np.float32(1.3981999507e-3), np.float32(1.9875691500e-4)


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
def dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INLINE)
def rows_of(R):  # type: ignore[no-untyped-def]
    """The rows of a (3, 3) array as tuples: read once, not in a loop that writes arrays."""
    return (R[0, 0], R[0, 1], R[0, 2]), (R[1, 0], R[1, 1], R[1, 2]), (R[2, 0], R[2, 1], R[2, 2])


@njit(**INLINE)
def rotate(R, v):  # type: ignore[no-untyped-def]
    """R v for the rows of R."""
    return dot(R[0], v), dot(R[1], v), dot(R[2], v)


@njit(**INLINE)
def unrotate(R, v):  # type: ignore[no-untyped-def]
    """R^T v for the rows of R."""
    return (
        R[0][0] * v[0] + R[1][0] * v[1] + R[2][0] * v[2],
        R[0][1] * v[0] + R[1][1] * v[1] + R[2][1] * v[2],
        R[0][2] * v[0] + R[1][2] * v[1] + R[2][2] * v[2],
    )


@njit(**INLINE)
def rotation(q):  # type: ignore[no-untyped-def]
    """Quaternion (w, x, y, z), any length -> the rows of R, and 1/|q|."""
    a, b, c, d = float(q[0]), float(q[1]), float(q[2]), float(q[3])
    s = 1.0 / np.sqrt(max(a * a + b * b + c * c + d * d, 1e-24))
    w, x, y, z = a * s, b * s, c * s, d * s
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ), s


@njit(**INLINE)
def axes_in_camera(q, log_scales, R_cw):  # type: ignore[no-untyped-def]
    """A Gaussian's three unit axes in the camera frame and their standard deviations, as tuples; R_cw as rows."""
    R, _ = rotation(q)
    s = (
        float(exp_fast(min(max(log_scales[0], np.float32(-20.0)), np.float32(8.0)))),
        float(exp_fast(min(max(log_scales[1], np.float32(-20.0)), np.float32(8.0)))),
        float(exp_fast(min(max(log_scales[2], np.float32(-20.0)), np.float32(8.0)))),
    )
    return (
        rotate(R_cw, (R[0][0], R[1][0], R[2][0])),
        rotate(R_cw, (R[0][1], R[1][1], R[2][1])),
        rotate(R_cw, (R[0][2], R[1][2], R[2][2])),
        s,
    )


@njit(**INLINE)
def camera_covariance(axes):  # type: ignore[no-untyped-def]
    """Upper triangle (xx, xy, xz, yy, yz, zz) of the covariance with those axes."""
    a, b, c, s = axes
    u, v, w = s[0] * s[0], s[1] * s[1], s[2] * s[2]
    return (
        u * a[0] * a[0] + v * b[0] * b[0] + w * c[0] * c[0],
        u * a[0] * a[1] + v * b[0] * b[1] + w * c[0] * c[1],
        u * a[0] * a[2] + v * b[0] * b[2] + w * c[0] * c[2],
        u * a[1] * a[1] + v * b[1] * b[1] + w * c[1] * c[1],
        u * a[1] * a[2] + v * b[1] * b[2] + w * c[1] * c[2],
        u * a[2] * a[2] + v * b[2] * b[2] + w * c[2] * c[2],
    )


@njit(**INLINE)
def symmetric_times(C, v):  # type: ignore[no-untyped-def]
    """C v for C = (xx, xy, xz, yy, yz, zz)."""
    return (
        C[0] * v[0] + C[1] * v[1] + C[2] * v[2],
        C[1] * v[0] + C[3] * v[1] + C[4] * v[2],
        C[2] * v[0] + C[4] * v[1] + C[5] * v[2],
    )


@njit(**INLINE)
def tangent_basis(m):  # type: ignore[no-untyped-def]
    """East and south at unit direction m (any orthonormal pair at the poles themselves)."""
    rho = np.sqrt(m[0] * m[0] + m[2] * m[2])
    pole = rho < 1e-9
    inv = 1.0 / max(rho, 1e-9)
    ex, ez = 1.0 if pole else m[2] * inv, 0.0 if pole else -m[0] * inv
    return (ex, 0.0, ez), (m[1] * ez, m[2] * ex - m[0] * ez, -m[1] * ex)


@njit(**INLINE)
def whiten(S00, S01, S11):  # type: ignore[no-untyped-def]
    """Upper-triangular W with W^T W = S^-1, so that t = W d has unit covariance."""
    w00 = 1.0 / np.sqrt(max(S00 - S01 * S01 / S11, 1e-30))
    return w00, -w00 * S01 / S11, 1.0 / np.sqrt(S11)

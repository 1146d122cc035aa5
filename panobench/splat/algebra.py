"""Small vectors and matrices as tuples of floats: arrays would be heap allocations, millions of them a second.

Everything here is free of branches and of calls that LLVM cannot vectorise, so that kernels may loop over a block of
Gaussians (``kernels.block``) several at a time.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.fast_math import exp_fast
from panobench.kernels.jit import INLINE, njit


@njit(**INLINE)
def dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INLINE)
def rows_of(R):  # type: ignore[no-untyped-def]
    """The rows of a (3, 3) array as tuples, to be read once and not in a loop that writes arrays."""
    return (R[0, 0], R[0, 1], R[0, 2]), (R[1, 0], R[1, 1], R[1, 2]), (R[2, 0], R[2, 1], R[2, 2])


@njit(**INLINE)
def rotate(R, v):  # type: ignore[no-untyped-def]
    """R v, for R given by its rows."""
    return dot(R[0], v), dot(R[1], v), dot(R[2], v)


@njit(**INLINE)
def unrotate(R, v):  # type: ignore[no-untyped-def]
    """R^T v, for R given by its rows."""
    return (
        R[0][0] * v[0] + R[1][0] * v[1] + R[2][0] * v[2],
        R[0][1] * v[0] + R[1][1] * v[1] + R[2][1] * v[2],
        R[0][2] * v[0] + R[1][2] * v[1] + R[2][2] * v[2],
    )


@njit(**INLINE)
def rotation(q):  # type: ignore[no-untyped-def]
    """Quaternion (w, x, y, z) of any length -> the rows of its rotation matrix, and 1/|q|."""
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
    """A Gaussian's three unit axes in the camera frame, and its standard deviations along them; R_cw by its rows."""
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
    """Covariance in the camera frame, upper triangle (xx, xy, xz, yy, yz, zz), from ``axes_in_camera``."""
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
    """C v for a symmetric C = (xx, xy, xz, yy, yz, zz)."""
    return (
        C[0] * v[0] + C[1] * v[1] + C[2] * v[2],
        C[1] * v[0] + C[3] * v[1] + C[4] * v[2],
        C[2] * v[0] + C[4] * v[1] + C[5] * v[2],
    )


@njit(**INLINE)
def tangent_basis(m):  # type: ignore[no-untyped-def]
    """Unit vectors to the east and south at unit direction m; at the poles themselves, some orthonormal pair."""
    rho = np.sqrt(m[0] * m[0] + m[2] * m[2])
    pole = rho < 1e-9
    inv = 1.0 / max(rho, 1e-9)
    ex, ez = 1.0 if pole else m[2] * inv, 0.0 if pole else -m[0] * inv
    return (ex, 0.0, ez), (m[1] * ez, m[2] * ex - m[0] * ez, -m[1] * ex)


@njit(**INLINE)
def whiten(S00, S01, S11):  # type: ignore[no-untyped-def]
    """(w00, w01, w11) of the upper-triangular W with W^T W = S^-1, so that t = W d has unit covariance."""
    w00 = 1.0 / np.sqrt(max(S00 - S01 * S01 / S11, 1e-30))
    return w00, -w00 * S01 / S11, 1.0 / np.sqrt(S11)

"""Warping where rays begin in the centre of the lens that they belong to (see ``cameras.rig_panorama``).

The parameters of a camera with one centre are (6,), those of ``kernels.columns.CameraColumns`` as far as ``cy``. Those
of a rig are (2 + L, 6): the same, then the units of the map in a metre, then for each lens its axis (3) and its centre
(3) in metres. Numba compiles kernels for either number of dimensions and leaves out what the other needs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.rig_panorama import LensCentres
from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import INLINE, INLINE_FINITE, JIT_FINITE, njit

#: Rows of a rig's parameters, and the first column of a lens's centre.
UNITS, FIRST, CENTRE = 1, 2, 3
_HALF, _PER_TURN, _TWO = np.float32(0.5), np.float32(0.5 / np.pi), np.float32(2)


def rig_parameters(panorama: NDArray[np.float32], lenses: LensCentres) -> NDArray[np.float32]:
    """(2 + L, 6): of a rig, from those of its panorama (6,)."""
    units = np.array([lenses.units_per_metre, 0, 0, 0, 0, 0])
    each = np.concatenate([lenses.axes, lenses.centres_m], axis=1)
    return np.concatenate([panorama[None], units[None], each]).astype(np.float32)


def origins_of(rays: NDArray[np.float32], cam: NDArray[np.float32]) -> NDArray[np.float32]:
    """Where rays (n, 3) of a rig's panorama begin, (3, n), in metres."""
    number = np.argmax(rays @ cam[FIRST:, :CENTRE].T, axis=1)
    return np.ascontiguousarray(cam[FIRST + number, CENTRE:].T)


@njit(**INLINE)
def panorama_of(cam):  # type: ignore[no-untyped-def]
    """The parameters (6,) that do not depend on centres."""
    if cam.ndim == 2:
        return cam[0]
    return cam


@njit(**INLINE_FINITE)
def nearest_lens(x, y, z, cam):  # type: ignore[no-untyped-def]
    """The row of the lens that a direction or point belongs to."""
    best, at = np.float32(-1e30), FIRST
    for k in range(FIRST, cam.shape[0]):
        along = cam[k, 0] * x + cam[k, 1] * y + cam[k, 2] * z
        if along > best:
            best, at = along, k
    return at


@njit(**INLINE)
def origin_of(x, y, z, cam):  # type: ignore[no-untyped-def]
    """Where the ray (x, y, z) of a rig begins."""
    at, s = nearest_lens(x, y, z, cam), cam[UNITS, 0]
    return s * cam[at, 3], s * cam[at, 4], s * cam[at, 5]


@njit(**INLINE)
def moved_origin(R, t, x, y, z, cam):  # type: ignore[no-untyped-def]
    """Where the ray (x, y, z) of any camera begins once it is moved by R (3, 3), t (3,)."""
    if cam.ndim == 2:
        ox, oy, oz = origin_of(x, y, z, cam)
        return (
            R[0, 0] * ox + R[0, 1] * oy + R[0, 2] * oz + t[0],
            R[1, 0] * ox + R[1, 1] * oy + R[1, 2] * oz + t[1],
            R[2, 0] * ox + R[2, 1] * oy + R[2, 2] * oz + t[2],
        )
    return t[0], t[1], t[2]


@njit(**INLINE)
def pixel_from_lenses(x, y, z, cam):  # type: ignore[no-untyped-def]
    """As ``warp.to_pixel``, from the lens that the point belongs to."""
    ox, oy, oz = origin_of(x, y, z, cam)
    x, y, z = x - ox, y - oy, z - oz
    u = cam[0, 0] * (_HALF + atan2_fast(x, z) * _PER_TURN)
    v = cam[0, 1] * (_HALF + _TWO * atan2_fast(y, np.sqrt(x * x + z * z)) * _PER_TURN)
    return u, v, True


@njit(**JIT_FINITE)
def project_from_lenses(X, Y, Z, R, t, cam, u, v):  # type: ignore[no-untyped-def]
    """As ``warp.project_panorama``, each point as the lens sees it that it belongs to."""
    w, h, s = cam[0, 0], cam[0, 1], cam[UNITS, 0]
    for k in range(len(X)):
        x, y, z = X[k], Y[k], Z[k]
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        at = nearest_lens(px, py, pz, cam)
        px -= s * cam[at, 3]
        py -= s * cam[at, 4]
        pz -= s * cam[at, 5]
        rho = np.sqrt(px * px + pz * pz)
        u[k] = w * (_HALF + atan2_fast(px, pz) * _PER_TURN)
        v[k] = h * (_HALF + _TWO * atan2_fast(py, rho) * _PER_TURN)


@njit(**JIT_FINITE)
def shells_from_lenses(depths, rx, ry, rz, tx, ty, tz, cam, u, v):  # type: ignore[no-untyped-def]
    """As ``sweep._shells_panorama``, each point as the lens sees it that it belongs to."""
    w, h, s = cam[0, 0], cam[0, 1], cam[UNITS, 0]
    for k in range(len(depths)):
        x, y, z = depths[k] * rx + tx, depths[k] * ry + ty, depths[k] * rz + tz
        at = nearest_lens(x, y, z, cam)
        x -= s * cam[at, 3]
        y -= s * cam[at, 4]
        z -= s * cam[at, 5]
        rho = np.sqrt(x * x + z * z)
        a = w * (_HALF + atan2_fast(x, z) * _PER_TURN) + _HALF
        b = h * (_HALF + _TWO * atan2_fast(y, rho) * _PER_TURN) + _HALF
        u[k], v[k] = min(max(a, _HALF), w + _HALF), min(max(b, np.float32(0)), h)


@njit(**JIT_FINITE)
def jacobians_from_lenses(points, origins, R, t, cam, gx, gy, J, jd, js):  # type: ignore[no-untyped-def]
    """As ``bundle._jacobians``, and js (n,), the derivative by the map's units in a metre.

    origins (3, n): where the rays of ``points`` (3, n) begin, in metres.
    """
    a, e, s = cam[0, 0] * _PER_TURN, _TWO * cam[0, 1] * _PER_TURN, cam[UNITS, 0]
    for k in range(len(gx)):
        ox, oy, oz = origins[0, k], origins[1, k], origins[2, k]
        mx = R[0, 0] * ox + R[0, 1] * oy + R[0, 2] * oz
        my = R[1, 0] * ox + R[1, 1] * oy + R[1, 2] * oz
        mz = R[2, 0] * ox + R[2, 1] * oy + R[2, 2] * oz
        px, py, pz = points[0, k], points[1, k], points[2, k]
        qx = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz
        qy = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz
        qz = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz
        x, y, z = qx + t[0], qy + t[1], qz + t[2]
        at = nearest_lens(x, y, z, cam)
        cx, cy, cz = cam[at, 3], cam[at, 4], cam[at, 5]
        X, Y, Z = x - s * cx, y - s * cy, z - s * cz
        rho2 = X * X + Z * Z
        rho, r2 = np.sqrt(rho2), rho2 + Y * Y
        p, q = gx[k] * a / rho2, gy[k] * e / (r2 * rho)
        jx = p * Z - q * X * Y
        jy = q * rho2
        jz = -p * X - q * Z * Y
        J[0, k], J[1, k], J[2, k] = jx, jy, jz
        J[3, k], J[4, k], J[5, k] = y * jz - z * jy, z * jx - x * jz, x * jy - y * jx
        jd[k] = jx * (qx - s * mx) + jy * (qy - s * my) + jz * (qz - s * mz)
        js[k] = jx * (mx - cx) + jy * (my - cy) + jz * (mz - cz)

"""Kernels of photometric bundle adjustment: residuals of a reference's pixels in many frames, and what follows of them.

Pixels are processed in blocks, and each loop over a block does a single thing, so that all loops are vectorised.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.columns import CAM
from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange
from panobench.photometric.lens_centres import jacobians_from_lenses
from panobench.photometric.normal_equations import add_rotation_rows, add_translation_rows
from panobench.photometric.warp import PER_TURN, project, sample_run

#: Pixels in a block, which are processed together.
_BLOCK = 256
_F0, _F1, _HALF, _OUTSIDE, _NAN = np.float32(0), np.float32(1), np.float32(0.5), np.float32(10), np.float32(np.nan)


@njit(**JIT_FINITE)
def _jacobians(points, R, t, code, cam, gx, gy, J, jd):  # type: ignore[no-untyped-def]
    """Write the residuals' derivatives: J (6, n) by a left twist of R, t, and jd (n,) by the log depth.

    points (3, n): in the reference camera's frame; gx, gy (n,): the image's gradient where they are seen.
    """
    a, e = cam[CAM.width] * PER_TURN, np.float32(2) * cam[CAM.height] * PER_TURN
    for k in range(len(gx)):
        px, py, pz = points[0, k], points[1, k], points[2, k]
        qx = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz
        qy = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz
        qz = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz
        x, y, z = qx + t[0], qy + t[1], qz + t[2]
        if code == 0:
            rho2 = x * x + z * z
            rho, r2 = np.sqrt(rho2), rho2 + y * y
            p, q = gx[k] * a / rho2, gy[k] * e / (r2 * rho)
            jx = p * z - q * x * y
            jy = q * rho2
            jz = -p * x - q * z * y
        else:
            jx, jy = gx[k] * cam[CAM.fx] / z, gy[k] * cam[CAM.fy] / z
            jz = -(jx * x + jy * y) / z
        J[0, k], J[1, k], J[2, k] = jx, jy, jz
        J[3, k], J[4, k], J[5, k] = y * jz - z * jy, z * jx - x * jz, x * jy - y * jx
        jd[k] = jx * qx + jy * qy + jz * qz


@njit(**JIT)
def _robust(seen, value, huber, cut, r, w, gx, gy, cost, size):  # type: ignore[no-untyped-def]
    """Samples ``seen`` and gradients (n,) -> residuals r, Huber weights w and absolute residuals size (n,).

    The pixels' costs are added to ``cost`` (n,). Samples that are masked or outside (NaN) or beyond ``cut`` have no
    weight, and cost what one at the cut does.
    """
    unseen = huber * (cut - _HALF * huber)
    for k in range(len(value)):
        e = seen[k] - value[k]
        a = abs(e)
        known = a + abs(gx[k]) + abs(gy[k]) < _OUTSIDE
        used = known & (a <= cut)
        size[k] = a if known else _NAN
        linear = a > huber
        cost[k] += (huber * (a - _HALF * huber) if linear else _HALF * a * a) if used else unseen
        w[k] = (huber / a if linear else _F1) if used else _F0
        r[k] = e if used else _F0
        gx[k], gy[k] = gx[k] if used else _F0, gy[k] if used else _F0


@njit(**JIT)
def _depth_rows(w, r, J, jd, Hpd, Hdd, bd):  # type: ignore[no-untyped-def]
    """Add to Hdd, bd (n,), the entries of the log depths, and write Hpd (6, n), those of the pose with each of them."""
    for k in range(len(w)):
        wd = w[k] * jd[k]
        Hdd[k] += wd * jd[k]
        bd[k] += wd * r[k]
    for i in range(6):
        for k in range(len(w)):
            Hpd[i, k] = w[k] * J[i, k] * jd[k]


@njit(**JIT_FINITE)
def _unit_rows(w, r, J, jd, js, Hsp, Hsd, Hss):  # type: ignore[no-untyped-def]
    """Add the entries of the map's units in a metre: to Hsp (6,), Hsd (n,) and Hss (2,), the last of which is b."""
    for k in range(len(w)):
        ws = w[k] * js[k]
        Hss[0] += ws * js[k]
        Hss[1] += ws * r[k]
        Hsd[k] += ws * jd[k]
    for i in range(6):
        total = _F0
        for k in range(len(w)):
            total += w[k] * js[k] * J[i, k]
        Hsp[i] += total


@njit(**JIT)
def _residuals_of(  # type: ignore[no-untyped-def]
    first, last, value, points, origins, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size,
    Hsp, Hsd, Hss,
):  # fmt: skip
    """Pixels first .. last - 1 of ``residuals``, a block at a time, so that all loops are vectorised."""
    u, v, seen = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    r, w, jd = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    gx, gy = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    J, js = np.empty((6, _BLOCK), np.float32), np.empty(_BLOCK, np.float32)
    for lo in range(first, last, _BLOCK):
        hi = min(lo + _BLOCK, last)
        m = hi - lo
        X = points[:, lo:hi]
        for f in range(frames.shape[0]):
            project(X[0], X[1], X[2], R[f], t[f], code, cam, u, v)
            sample_run(frames[f], u[:m], v[:m], code, seen, gx, gy)
            _robust(seen, value[lo:hi], huber, cut, r, w, gx, gy, cost[lo:hi], size[f, lo:hi])
            if cam.ndim == 2:
                jacobians_from_lenses(X, origins[:, lo:hi], R[f], t[f], cam, gx[:m], gy[:m], J, jd, js)
                _unit_rows(w[:m], r, J, jd, js, Hsp[f], Hsd[lo:hi], Hss)
            else:
                _jacobians(X, R[f], t[f], code, cam, gx[:m], gy[:m], J, jd)
            _depth_rows(w[:m], r, J, jd, Hpd[f, :, lo:hi], Hdd[lo:hi], bd[lo:hi])
            add_translation_rows(w[:m], r, J, 0, Hpp[f], bp[f])
            add_rotation_rows(w[:m], r, J, 0, Hpp[f], bp[f])


@njit(**PARALLEL)
def residuals(  # type: ignore[no-untyped-def]
    value, points, origins, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size, Hsp, Hsd, Hss
):
    """Normal equations of P pixels in F frames; the arrays written come in as zeros.

    value (P,), points (3, P): luma and position of the reference's pixels. origins (3, P): where their rays begin, in
    metres; (3, 0) for one centre. frames (F, H, W); R (F, 3, 3), t (F, 3): frame from reference camera. huber, cut: of
    1. Written for each pixel: Hpd (F, 6, P), Hdd, bd, cost (P,), and size (F, P), the absolute residual, NaN where
    unseen. Written for each run of pixels: Hpp (runs, F, 6, 6), upper triangles, and bp (runs, F, 6). Written for a
    rig: Hsp (runs, F, 6), Hsd (P,), Hss (runs, 2); see ``_unit_rows``.
    """
    runs = Hpp.shape[0]
    share = (len(value) + runs - 1) // runs
    for run in prange(runs):
        _residuals_of(
            run * share, min((run + 1) * share, len(value)), value, points, origins, frames, R, t, code, cam, huber,
            cut, Hpd, Hdd, bd, Hpp[run], bp[run], cost, size, Hsp[run], Hsd, Hss[run],
        )  # fmt: skip

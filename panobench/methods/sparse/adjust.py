"""Least squares on bearing vectors: pose from known points, and bundle adjustment with the Schur complement.

The residual is the direction of a point in the camera minus its measured bearing, on the bearing's tangent plane,
times ``focal``. This is in pixels of a face's centre, everywhere on the sphere and for every camera model. Each bearing
begins at an origin in the camera's axes: the centre of the lens that saw it, zero for a central camera. Solved by
Levenberg-Marquardt with Huber weights and the left perturbation T_cw <- exp(xi) T_cw, xi = (translation, rotation).
Schur complement: Triggs et al., "Bundle adjustment - a modern synthesis" (1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from panobench.geometry import renormalise
from panobench.methods.sparse.patches import tangent_basis

Array = NDArray[np.float64]


@njit(cache=True)
def _exp(xi, R, t):  # type: ignore[no-untyped-def]
    """(R, t) <- exp(xi) (R, t), in place, by Rodrigues' formula."""
    wx, wy, wz = xi[3], xi[4], xi[5]
    theta2 = wx * wx + wy * wy + wz * wz
    theta = math.sqrt(theta2)
    if theta < 1e-6:
        a, b, c = 1 - theta2 / 6, 0.5 - theta2 / 24, 1 / 6 - theta2 / 120
    else:
        a, b, c = math.sin(theta) / theta, (1 - math.cos(theta)) / theta2, (theta - math.sin(theta)) / (theta2 * theta)
    for column in range(4):
        if column < 3:
            x, y, z = R[0, column], R[1, column], R[2, column]
        else:
            x, y, z = t[0], t[1], t[2]
        px, py, pz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        qx, qy, qz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
        x, y, z = x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz
        if column < 3:
            R[0, column], R[1, column], R[2, column] = x, y, z
        else:
            t[0], t[1], t[2] = x, y, z
    x, y, z = xi[0], xi[1], xi[2]
    px, py, pz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    qx, qy, qz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
    t[0] += x + b * px + c * qx
    t[1] += y + b * py + c * qy
    t[2] += z + b * pz + c * qz


@njit(cache=True)
def _residual(R, t, X, c, b, focal, J, Y):  # type: ignore[no-untyped-def]
    """Residual (2,) in pixels of a bearing b that begins at c, both (3,) in the camera frame.

    Writes the point in the camera frame to Y (3,) and the derivative by it to J (2, 3).
    """
    for r in range(3):
        Y[r] = R[r, 0] * X[0] + R[r, 1] * X[1] + R[r, 2] * X[2] + t[r]
    d0, d1, d2 = Y[0] - c[0], Y[1] - c[1], Y[2] - c[2]
    norm = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) + 1e-12
    m0, m1, m2 = d0 / norm, d1 / norm, d2 / norm
    ax, ay, az, cx, cy, cz = tangent_basis(b[0], b[1], b[2])
    e0, e1 = ax * m0 + ay * m1 + az * m2, cx * m0 + cy * m1 + cz * m2
    s = focal / norm
    J[0, 0], J[0, 1], J[0, 2] = s * (ax - e0 * m0), s * (ay - e0 * m1), s * (az - e0 * m2)
    J[1, 0], J[1, 1], J[1, 2] = s * (cx - e1 * m0), s * (cy - e1 * m1), s * (cz - e1 * m2)
    if m0 * b[0] + m1 * b[1] + m2 * b[2] < 0:  # more than 90 degrees off: the cost of 90 degrees
        return focal, focal
    return focal * e0, focal * e1


@njit(cache=True)
def _pose_row(J, Y, i, row):  # type: ignore[no-untyped-def]
    """Row i of d(residual) / d(xi) = [J, -J hat(Y)]."""
    row[0], row[1], row[2] = J[i, 0], J[i, 1], J[i, 2]
    row[3] = Y[1] * J[i, 2] - Y[2] * J[i, 1]
    row[4] = Y[2] * J[i, 0] - Y[0] * J[i, 2]
    row[5] = Y[0] * J[i, 1] - Y[1] * J[i, 0]


@njit(cache=True)
def _pose_cost(R, t, X, o, b, focal, huber):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    cost = 0.0
    for n in range(len(X)):
        e0, e1 = _residual(R, t, X[n], o[n], b[n], focal, J, Y)
        q = e0 * e0 + e1 * e1
        cost += q if q < huber * huber else 2 * huber * math.sqrt(q) - huber * huber
    return cost


@njit(cache=True)
def _pose_system(R, t, X, o, b, focal, huber, H, g):  # type: ignore[no-untyped-def]
    """Normal equations of one pose: adds to H (6, 6) and g (6,)."""
    J, Y = np.empty((2, 3)), np.empty(3)
    row = np.empty(6)
    for n in range(len(X)):
        e0, e1 = _residual(R, t, X[n], o[n], b[n], focal, J, Y)
        q = math.sqrt(e0 * e0 + e1 * e1)
        w = 1.0 if q < huber else huber / q
        for i in range(2):
            e = e0 if i == 0 else e1
            _pose_row(J, Y, i, row)
            for r in range(6):
                g[r] += w * row[r] * e
                for c in range(6):
                    H[r, c] += w * row[r] * row[c]


@njit(cache=True)
def _errors(R, t, kf, pt, X, o, b, focal, out):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    for n in range(len(kf)):
        e0, e1 = _residual(R[kf[n]], t[kf[n]], X[pt[n]], o[n], b[n], focal, J, Y)
        out[n] = math.sqrt(e0 * e0 + e1 * e1)


def solve_pose(
    T_cw: Array,
    points: Array,
    bearings: Array,
    focal: float,
    huber: float,
    iterations: int = 10,
    origins: Array | None = None,
) -> Array:
    """World-to-camera pose (4, 4) that fits points (N, 3) seen along bearings (N, 3) best; ``T_cw`` is the start.

    origins (N, 3): where the bearings begin in the camera's axes; None: at its centre.
    """
    if len(points) < 3:
        return T_cw
    X, b, o = np.ascontiguousarray(points), np.ascontiguousarray(bearings), _origins(origins, len(points))
    R, t = T_cw[:3, :3].copy(), T_cw[:3, 3].copy()
    cost, damping = _pose_cost(R, t, X, o, b, focal, huber), 1e-4
    for _ in range(iterations):
        H, g = np.zeros((6, 6)), np.zeros(6)
        _pose_system(R, t, X, o, b, focal, huber, H, g)
        new = cost
        for _ in range(5):
            R2, t2 = R.copy(), t.copy()
            _exp(-np.linalg.solve(H + np.diag(damping * np.diag(H) + 1e-9), g), R2, t2)
            new = _pose_cost(R2, t2, X, o, b, focal, huber)
            if new < cost:
                break
            damping *= 10
        if not new < cost:
            break
        small = cost - new < 1e-6 * cost
        R, t, cost, damping = R2, t2, new, damping * 0.1
        if small:
            break
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return renormalise(T)


def _origins(origins: Array | None, count: int) -> Array:
    return np.zeros((count, 3)) if origins is None else np.ascontiguousarray(origins, dtype=np.float64)


def pose_errors(T_cw: Array, points: Array, bearings: Array, focal: float, origins: Array | None = None) -> Array:
    """Lengths (N,) of the residuals in pixels."""
    o = _origins(origins, len(points))
    out = np.empty(len(points))
    zero, index = np.zeros(len(points), np.int64), np.arange(len(points))
    R, t = np.ascontiguousarray(T_cw[None, :3, :3]), np.ascontiguousarray(T_cw[None, :3, 3])
    _errors(R, t, zero, index, np.ascontiguousarray(points), o, np.ascontiguousarray(bearings), focal, out)
    return out


@njit(cache=True)
def _ba_cost(R, t, X, kf, pt, o, b, focal, huber):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    cost = 0.0
    for n in range(len(kf)):
        e0, e1 = _residual(R[kf[n]], t[kf[n]], X[pt[n]], o[n], b[n], focal, J, Y)
        q = e0 * e0 + e1 * e1
        cost += q if q < huber * huber else 2 * huber * math.sqrt(q) - huber * huber
    return cost


@njit(cache=True)
def _ba_system(R, t, X, kf, pt, o, b, first, slot, focal, huber, Hc, gc, Hp, gp, Hcp):  # type: ignore[no-untyped-def]
    """Normal equations: adds to Hc (C, 6, 6), gc (C, 6), Hp (P, 3, 3), gp (P, 3) and Hcp (N, 6, 3).

    slot (K,): a keyframe's position among the free poses, negative if its pose is fixed.
    """
    J, Y = np.empty((2, 3)), np.empty(3)
    row, side = np.empty(6), np.empty(3)
    for n in range(len(kf)):
        k, p = kf[n], pt[n]
        Rk = R[k]
        e0, e1 = _residual(Rk, t[k], X[p], o[n], b[n], focal, J, Y)
        q = math.sqrt(e0 * e0 + e1 * e1)
        w = 1.0 if q < huber else huber / q
        s = slot[k]
        for i in range(2):
            e = e0 if i == 0 else e1
            for c in range(3):
                side[c] = J[i, 0] * Rk[0, c] + J[i, 1] * Rk[1, c] + J[i, 2] * Rk[2, c]
            for r in range(3):
                gp[p, r] += w * side[r] * e
                for c in range(3):
                    Hp[p, r, c] += w * side[r] * side[c]
            if s >= 0:
                _pose_row(J, Y, i, row)
                for r in range(6):
                    gc[s, r] += w * row[r] * e
                    for c in range(6):
                        Hc[s, r, c] += w * row[r] * row[c]
                    for c in range(3):
                        Hcp[n, r, c] += w * row[r] * side[c]


@njit(cache=True)
def _inverse3(M, out):  # type: ignore[no-untyped-def]
    a, b, c, d, e, f = M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    if det <= 0:
        det = 1e300
    out[0, 0], out[0, 1], out[0, 2] = A / det, B / det, C / det
    out[1, 1], out[1, 2], out[2, 2] = (a * f - c * c) / det, (b * c - a * e) / det, (a * d - b * b) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@njit(cache=True)
def _schur(kf, first, slot, Hc, gc, Hp, gp, Hcp, damping, S, g, Hp_inv):  # type: ignore[no-untyped-def]
    """Reduced camera system S x = g; observations are sorted by point. Only the upper blocks of S are filled."""
    for s in range(len(Hc)):
        for r in range(6):
            g[6 * s + r] = gc[s, r]
            for c in range(6):
                S[6 * s + r, 6 * s + c] = Hc[s, r, c]
            S[6 * s + r, 6 * s + r] += damping * Hc[s, r, r] + 1e-9
    M = np.empty((3, 3))
    E = np.empty((6, 3))
    for p in range(len(Hp)):
        for r in range(3):
            for c in range(3):
                M[r, c] = Hp[p, r, c]
            M[r, r] += damping * Hp[p, r, r] + 1e-9
        V = Hp_inv[p]
        _inverse3(M, V)
        for n in range(first[p], first[p + 1]):
            s = slot[kf[n]]
            if s < 0:
                continue
            for r in range(6):
                for c in range(3):
                    E[r, c] = Hcp[n, r, 0] * V[0, c] + Hcp[n, r, 1] * V[1, c] + Hcp[n, r, 2] * V[2, c]
                g[6 * s + r] -= E[r, 0] * gp[p, 0] + E[r, 1] * gp[p, 1] + E[r, 2] * gp[p, 2]
            for m in range(n, first[p + 1]):
                o = slot[kf[m]]
                if o < 0:
                    continue
                for r in range(6):
                    for c in range(6):
                        S[6 * s + r, 6 * o + c] -= (
                            E[r, 0] * Hcp[m, c, 0] + E[r, 1] * Hcp[m, c, 1] + E[r, 2] * Hcp[m, c, 2]
                        )


@njit(cache=True)
def _back_substitute(kf, first, slot, Hcp, gp, Hp_inv, x, X, out):  # type: ignore[no-untyped-def]
    v = np.empty(3)
    for p in range(len(X)):
        for r in range(3):
            v[r] = gp[p, r]
        for n in range(first[p], first[p + 1]):
            s = slot[kf[n]]
            if s >= 0:
                for c in range(3):
                    for r in range(6):
                        v[c] += Hcp[n, r, c] * x[6 * s + r]
        for r in range(3):
            out[p, r] = X[p, r] - (Hp_inv[p, r, 0] * v[0] + Hp_inv[p, r, 1] * v[1] + Hp_inv[p, r, 2] * v[2])


@dataclass
class BundleResult:
    """T_cw (K, 4, 4); points (P, 3); errors (N,), residual lengths in pixels in the order of the observations; cost,
    the robust cost in squared pixels.
    """

    T_cw: Array
    points: Array
    errors: Array
    cost: float


def bundle_adjust(
    T_cw: Array,
    points: Array,
    keyframe: NDArray[np.int64],
    point: NDArray[np.int64],
    bearings: Array,
    fixed: NDArray[np.bool_],
    focal: float,
    huber: float,
    iterations: int = 8,
    origins: Array | None = None,
) -> BundleResult:
    """Refine the poses (K, 4, 4) that are not ``fixed`` (K,), and all points (P, 3).

    Observation n: keyframe[n] saw point[n] along the unit vector bearings[n], which begins at origins[n] in the
    keyframe's axes (None: at its centre). Observations can be in any order.
    """
    order = np.lexsort((keyframe, point))
    kf, pt = keyframe[order].astype(np.int64), point[order].astype(np.int64)
    b = np.ascontiguousarray(bearings[order], dtype=np.float64)
    o = _origins(None if origins is None else origins[order], len(order))
    first = np.searchsorted(pt, np.arange(len(points) + 1)).astype(np.int64)
    slot = np.where(fixed, -1, np.cumsum(~fixed) - 1).astype(np.int64)
    free = int((~fixed).sum())
    R, t = np.ascontiguousarray(T_cw[:, :3, :3]), np.ascontiguousarray(T_cw[:, :3, 3])
    X = np.ascontiguousarray(points, dtype=np.float64).copy()
    Hc, gc = np.empty((free, 6, 6)), np.empty((free, 6))
    Hp, gp, Hp_inv = np.empty((len(X), 3, 3)), np.empty((len(X), 3)), np.empty((len(X), 3, 3))
    Hcp = np.empty((len(kf), 6, 3))
    S, g, X2 = np.empty((6 * free, 6 * free)), np.empty(6 * free), np.empty_like(X)
    cost = _ba_cost(R, t, X, kf, pt, o, b, focal, huber)
    damping = 1e-4
    for _ in range(iterations):
        for array in (Hc, gc, Hp, gp, Hcp):
            array.fill(0.0)
        _ba_system(R, t, X, kf, pt, o, b, first, slot, focal, huber, Hc, gc, Hp, gp, Hcp)
        improved = False
        for _ in range(5):
            S.fill(0.0)
            g.fill(0.0)
            _schur(kf, first, slot, Hc, gc, Hp, gp, Hcp, damping, S, g, Hp_inv)
            full = _symmetric(S)
            x = -np.linalg.solve(full, g) if free else np.empty(0)
            R2, t2 = R.copy(), t.copy()
            for k in np.flatnonzero(slot >= 0):
                _exp(x[6 * slot[k] : 6 * slot[k] + 6], R2[k], t2[k])
            _back_substitute(kf, first, slot, Hcp, gp, Hp_inv, x, X, X2)
            new = _ba_cost(R2, t2, X2, kf, pt, o, b, focal, huber)
            if new < cost:
                improved = True
                break
            damping *= 10
        if not improved:
            break
        small = cost - new < 1e-5 * cost
        R, t, X, X2, cost = R2, t2, X2, X, new
        damping = max(damping * 0.1, 1e-8)
        if small:
            break
    errors = np.empty(len(kf))
    _errors(R, t, kf, pt, X, o, b, focal, errors)
    out = np.empty_like(errors)
    out[order] = errors
    T = np.tile(np.eye(4), (len(T_cw), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, t
    return BundleResult(renormalise(T), X.copy(), out, cost)


def pose_information(
    T_cw: Array,
    points: Array,
    keyframe: NDArray[np.int64],
    point: NDArray[np.int64],
    bearings: Array,
    fixed: NDArray[np.bool_],
    focal: float,
    huber: float,
    origins: Array | None = None,
) -> Array:
    """Normal matrix (6F, 6F) of the F poses that are not ``fixed``, (translation, rotation) each, points eliminated.

    Arguments as for ``bundle_adjust``. In squared pixels: divided by the residuals' variance it is the information.
    """
    order = np.lexsort((keyframe, point))
    kf, pt = keyframe[order].astype(np.int64), point[order].astype(np.int64)
    b = np.ascontiguousarray(bearings[order], dtype=np.float64)
    o = _origins(None if origins is None else origins[order], len(order))
    first = np.searchsorted(pt, np.arange(len(points) + 1)).astype(np.int64)
    slot = np.where(fixed, -1, np.cumsum(~fixed) - 1).astype(np.int64)
    free, count = int((~fixed).sum()), len(points)
    R, t = np.ascontiguousarray(T_cw[:, :3, :3]), np.ascontiguousarray(T_cw[:, :3, 3])
    X = np.ascontiguousarray(points, dtype=np.float64)
    Hc, gc = np.zeros((free, 6, 6)), np.zeros((free, 6))
    Hp, gp, Hcp = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((len(kf), 6, 3))
    _ba_system(R, t, X, kf, pt, o, b, first, slot, focal, huber, Hc, gc, Hp, gp, Hcp)
    S, g = np.zeros((6 * free, 6 * free)), np.zeros(6 * free)
    _schur(kf, first, slot, Hc, gc, Hp, gp, Hcp, 0.0, S, g, np.zeros((count, 3, 3)))
    return _symmetric(S)


def _symmetric(S: Array) -> Array:
    """The full matrix. A point's keyframes ascend, so only blocks on and above the diagonal are filled in S."""
    blocks = np.arange(len(S)) // 6
    upper = blocks[:, None] < blocks[None, :]
    U = np.where(upper, S, 0.0)
    return U + U.T + np.where(blocks[:, None] == blocks[None, :], S, 0.0)

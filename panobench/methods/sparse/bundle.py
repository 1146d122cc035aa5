"""Bundle adjustment of bearing vectors with the Schur complement; residuals are those of ``pose``.

Schur complement: Triggs et al., "Bundle adjustment - a modern synthesis" (1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise
from panobench.kernels.jit import njit
from panobench.methods.sparse.pose import all_errors, apply_increment, origins_of, pose_row, residual

Array = NDArray[np.float64]


@njit(cache=True)
def _ba_cost(R, t, X, kf, pt, o, b, focal, huber):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    cost = 0.0
    for n in range(len(kf)):
        e0, e1 = residual(R[kf[n]], t[kf[n]], X[pt[n]], o[n], b[n], focal, J, Y)
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
        e0, e1 = residual(Rk, t[k], X[p], o[n], b[n], focal, J, Y)
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
                pose_row(J, Y, i, row)
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


class _Observations(NamedTuple):
    """Observations in the order of their points, which the Schur complement needs: ``order`` (N,) is that order.

    keyframe, point (N,), bearings, origins (N, 3). first (P + 1,): where each point's observations begin. slot (K,): a
    keyframe's position among the ``free`` poses, -1 if its pose is fixed.
    """

    order: NDArray[np.intp]
    keyframe: NDArray[np.int64]
    point: NDArray[np.int64]
    bearings: Array
    origins: Array
    first: NDArray[np.int64]
    slot: NDArray[np.int64]
    free: int


def _by_point(
    points: int,
    keyframe: NDArray[np.int64],
    point: NDArray[np.int64],
    bearings: Array,
    origins: Array | None,
    fixed: NDArray[np.bool_],
) -> _Observations:
    order = np.lexsort((keyframe, point))
    sorted_points = point[order].astype(np.int64)
    return _Observations(
        order,
        keyframe[order].astype(np.int64),
        sorted_points,
        np.ascontiguousarray(bearings[order], dtype=np.float64),
        origins_of(None if origins is None else origins[order], len(order)),
        np.searchsorted(sorted_points, np.arange(points + 1)).astype(np.int64),
        np.where(fixed, -1, np.cumsum(~fixed) - 1).astype(np.int64),
        int((~fixed).sum()),
    )


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
    order, kf, pt, b, o, first, slot, free = _by_point(len(points), keyframe, point, bearings, origins, fixed)
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
                apply_increment(x[6 * slot[k] : 6 * slot[k] + 6], R2[k], t2[k])
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
    all_errors(R, t, kf, pt, X, o, b, focal, errors)
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
    _, kf, pt, b, o, first, slot, free = _by_point(len(points), keyframe, point, bearings, origins, fixed)
    count = len(points)
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

"""Two-view geometry of bearing vectors: essential matrix by five-point RANSAC, and its decomposition.

The five-point problem (Nister, PAMI 2004) is solved in Stewenius' form (Stewenius, Engels, Nister 2006): the
null space of five epipolar constraints, ten cubic constraints, and the eigenvectors of a 10x10 action matrix.
Nothing needs a positive z, so it works for panoramas and for pinhole images, and for planar scenes as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TwoView:
    """x2 = R x1 + t with |t| = 1; inliers (N,); points (N, 3) in the first camera's frame, NaN for outliers."""

    R: Array
    t: Array
    inliers: NDArray[np.bool_]
    points: Array


@lru_cache(maxsize=1)
def _monomials() -> tuple[tuple[tuple[int, ...], ...], dict[tuple[int, ...], int]]:
    """Cubic monomials of (x, y, z, 1) by indices 0..3: first the ten of degree three, then those of lower degree."""
    names = list(combinations_with_replacement(range(4), 3))
    high = [m for m in names if 3 not in m]
    low = [m for m in names if 3 in m]
    ordered = tuple(high + low)
    return ordered, {m: i for i, m in enumerate(ordered)}


@lru_cache(maxsize=1)
def _cubic_index() -> NDArray[np.int64]:
    """Index (4, 4, 4) of the monomial x_i x_j x_k."""
    _, where = _monomials()
    index = np.empty((4, 4, 4), np.int64)
    for i in range(4):
        for j in range(4):
            for k in range(4):
                index[i, j, k] = where[tuple(sorted((i, j, k)))]
    return index


def five_point(b1: Array, b2: Array) -> list[Array]:
    """Essential matrices E with b2^T E b1 = 0 for five pairs of bearings (5, 3)."""
    A = np.einsum("ni,nj->nij", b2, b1).reshape(len(b1), 9)
    N = np.linalg.svd(A)[2][-4:].reshape(4, 3, 3)
    # E = x N0 + y N1 + z N2 + N3; the constraints 2 E E^T E - tr(E E^T) E = 0 and det E = 0 as cubics.
    EEt = np.einsum("iab,jcb->ijac", N, N)
    trace = np.einsum("ijaa->ij", EEt)
    cubic = 2 * np.einsum("ijab,kbc->ijkac", EEt, N) - np.einsum("ij,kac->ijkac", trace, N)
    det = np.einsum("ia,jb,kc,abc->ijk", N[:, 0], N[:, 1], N[:, 2], _LEVI_CIVITA)
    rows = np.concatenate([cubic.reshape(64, 9), det.reshape(64, 1)], axis=1)
    M = np.zeros((20, 10))
    np.add.at(M, _cubic_index().ravel(), rows)
    M = M.T
    try:
        B = np.linalg.solve(M[:, :10], M[:, 10:])
    except np.linalg.LinAlgError:
        return []
    # Multiplication by x maps low monomials to cubic ones (-B) or to other low ones.
    ordered, where = _monomials()
    action = np.zeros((10, 10))
    for r, m in enumerate(ordered[10:]):
        product = list(m)
        product.remove(3)
        target = where[tuple(sorted([*product, 0]))]
        if target < 10:
            action[r] = -B[target]
        else:
            action[r, target - 10] = 1.0
    values, vectors = np.linalg.eig(action)
    index = [where[tuple(sorted((i, 3, 3)))] - 10 for i in range(3)]
    one = where[(3, 3, 3)] - 10
    out = []
    for value, vector in zip(values, vectors.T):
        if abs(value.imag) > 1e-8 or abs(vector[one]) < 1e-12:
            continue
        x, y, z = (vector[index] / vector[one]).real
        E = x * N[0] + y * N[1] + z * N[2] + N[3]
        out.append(E / np.linalg.norm(E))
    return out


_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k] = 1.0
    _LEVI_CIVITA[_i, _k, _j] = -1.0


def epipolar_angle(E: Array, b1: Array, b2: Array) -> Array:
    """Angle (N,) of each pair to its epipolar planes, the larger one of both views, radians."""
    l2, l1 = b1 @ E.T, b2 @ E
    s = np.abs(np.sum(b2 * l2, axis=1))
    e2 = s / np.maximum(np.linalg.norm(l2, axis=1), 1e-12)
    e1 = s / np.maximum(np.linalg.norm(l1, axis=1), 1e-12)
    return np.arcsin(np.minimum(1.0, np.maximum(e1, e2)))


def triangulate(b1: Array, b2: Array, R: Array, t: Array) -> tuple[Array, Array, Array]:
    """Midpoints (N, 3) of the rays in the first frame, and both ray lengths (N,); x2 = R x1 + t.

    Nearly parallel rays give huge or negative lengths, which the caller has to check.
    """
    d2 = b2 @ R  # second rays in the first frame
    c2 = -R.T @ t
    dot = np.sum(b1 * d2, axis=1)
    denom = np.maximum(1 - dot * dot, 1e-12)
    p, q = b1 @ c2, d2 @ c2
    s1 = (p - dot * q) / denom
    s2 = (dot * p - q) / denom
    points = 0.5 * (b1 * s1[:, None] + c2 + d2 * s2[:, None])
    return points, s1, s2


def decompose(E: Array) -> list[tuple[Array, Array]]:
    """The four motions (R, t) of an essential matrix."""
    U, _, Vt = np.linalg.svd(E)
    U = U * np.sign(np.linalg.det(U))
    Vt = Vt * np.sign(np.linalg.det(Vt))
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return [(U @ w @ Vt, s * U[:, 2]) for w in (W, W.T) for s in (1.0, -1.0)]


def essential_ransac(
    b1: Array, b2: Array, threshold: float, rng: np.random.Generator, iterations: int = 150, min_angle: float = 0.0
) -> TwoView | None:
    """Motion between two sets of matched bearings (N, 3). None if the result is ambiguous.

    threshold: of inliers, radians. min_angle: rays with less parallax (radians) do not vote on the sign of depth.
    """
    n = len(b1)
    if n < 12:
        return None
    best, best_score = None, -1.0
    tried = 0
    while tried < iterations:
        tried += 1
        sample = rng.choice(n, 5, replace=False)
        for E in five_point(b1[sample], b2[sample]):
            e = epipolar_angle(E, b1, b2)
            score = float(np.maximum(0.0, 1 - (e / threshold) ** 2).sum())
            if score > best_score:
                best, best_score = E, score
                share = float((e < threshold).mean())
                needed = np.log(1e-4) / np.log(max(1e-12, 1 - min(share, 0.999) ** 5))
                iterations = int(min(iterations, max(20, needed)))
    if best is None:
        return None
    inliers = epipolar_angle(best, b1, b2) < threshold
    candidates = []
    for R, t in decompose(best):
        points, s1, s2 = triangulate(b1, b2, R, t)
        angle = np.arccos(np.clip(np.sum((b1 @ R.T) * b2, axis=1), -1, 1))
        votes = inliers & (angle > min_angle)
        ahead = (s1 > 0) & (s2 > 0)
        candidates.append((int((votes & ahead).sum()), int(votes.sum()), R, t, points, inliers & ahead))
    candidates.sort(key=lambda c: -c[0])
    good, voters, R, t, points, keep = candidates[0]
    if good < 12 or good < 0.7 * voters or good < 1.3 * candidates[1][0]:
        return None
    return TwoView(R, t, keep, np.where(keep[:, None], points, np.nan))

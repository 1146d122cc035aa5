"""Absolute pose from bearings of known points: P3P (Grunert's quartic) in RANSAC, for any central camera.

Haralick, Lee, Ottenberg, Nolle, "Review and analysis of solutions of the three point perspective pose estimation
problem" (IJCV 1994), for the quartic's coefficients. Bearings may point in any direction, also behind the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.pose import pose_errors, solve_pose

Array = NDArray[np.float64]


def p3p(points: Array, bearings: Array) -> list[Array]:
    """World-to-camera poses (4, 4) that see points (3, 3) along unit bearings (3, 3); at most four."""
    a2 = float(np.sum((points[1] - points[2]) ** 2))
    b2 = float(np.sum((points[0] - points[2]) ** 2))
    c2 = float(np.sum((points[0] - points[1]) ** 2))
    if min(a2, b2, c2) < 1e-12:
        return []
    ca, cb, cg = (float(bearings[i] @ bearings[j]) for i, j in ((1, 2), (0, 2), (0, 1)))
    p, q, r = (a2 - c2) / b2, (a2 + c2) / b2, (b2 - c2) / b2
    A4 = (p - 1) ** 2 - 4 * c2 / b2 * ca * ca
    A3 = 4 * (p * (1 - p) * cb - (1 - q) * ca * cg + 2 * c2 / b2 * ca * ca * cb)
    A2 = 2 * (p * p - 1 + 2 * p * p * cb * cb + 2 * r * ca * ca - 4 * q * ca * cb * cg + 2 * (b2 - a2) / b2 * cg * cg)
    A1 = 4 * (-p * (1 + p) * cb + 2 * a2 / b2 * cg * cg * cb - (1 - q) * ca * cg)
    A0 = (1 + p) ** 2 - 4 * a2 / b2 * cg * cg
    out = []
    for v in np.roots([A4, A3, A2, A1, A0]):
        if abs(v.imag) > 1e-6 or v.real <= 0:
            continue
        v = float(v.real)
        denom = 2 * (cg - v * ca)
        if abs(denom) < 1e-9:
            continue
        u = ((-1 + p) * v * v - 2 * p * cb * v + 1 + p) / denom
        s = 1 + v * v - 2 * v * cb
        if u <= 0 or s <= 0:
            continue
        s1 = np.sqrt(b2 / s)
        local = bearings * np.array([s1, u * s1, v * s1])[:, None]
        # The rigid motion between the orthonormal frames of the two triangles.
        F, G = _triangle_frame(points), _triangle_frame(local)
        R = G @ F.T
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = local.mean(axis=0) - R @ points.mean(axis=0)
        out.append(T)
    return out


def _triangle_frame(X: Array) -> Array:
    e1 = X[1] - X[0]
    e1 = e1 / max(float(np.linalg.norm(e1)), 1e-12)
    n = np.cross(e1, X[2] - X[0])
    n = n / max(float(np.linalg.norm(n)), 1e-12)
    return np.column_stack([e1, np.cross(n, e1), n])


def pose_ransac(
    points: Array,
    bearings: Array,
    focal: float,
    rng: np.random.Generator,
    threshold: float = 3.0,
    iterations: int = 200,
    minimum: int = 12,
    lenses: Lenses | None = None,
) -> tuple[Array, NDArray[np.bool_]] | None:
    """World-to-camera pose (4, 4) and inliers (N,) of points (N, 3) seen along bearings (N, 3).

    ``threshold`` is in pixels of ``focal``. None with fewer than ``minimum`` inliers. lenses: where bearings begin; a
    sample is of one lens then, and its pose is moved to the rig.
    """
    n = len(points)
    if n < minimum:
        return None
    best, best_score, tried = None, -1.0, 0
    origins = None if lenses is None else lenses.origins(bearings)
    groups = None if lenses is None or origins is None else _of_one_lens(lenses.of(bearings))
    if groups is not None and not groups:
        return None
    while tried < iterations:
        tried += 1
        if groups is None:
            sample = rng.choice(n, 3, replace=False)
        else:
            sample = rng.choice(groups[int(rng.integers(len(groups)))], 3, replace=False)
        for T in p3p(points[sample], bearings[sample]):
            if origins is not None:
                T[:3, 3] += origins[sample[0]]
            e = pose_errors(T, points, bearings, focal, origins)
            score = float(np.maximum(0.0, 1 - (e / threshold) ** 2).sum())
            if score > best_score:
                best, best_score = T, score
                share = float((e < threshold).mean())
                needed = np.log(1e-4) / np.log(max(1e-12, 1 - min(share, 0.999) ** 3))
                iterations = int(min(iterations, max(10, needed)))
    if best is None:
        return None
    inliers = pose_errors(best, points, bearings, focal, origins) < threshold
    for _ in range(3):
        if int(inliers.sum()) < minimum:
            return None
        begin = None if origins is None else origins[inliers]
        best = solve_pose(best, points[inliers], bearings[inliers], focal, 1.0, origins=begin)
        inliers = pose_errors(best, points, bearings, focal, origins) < threshold
    return (best, inliers) if int(inliers.sum()) >= minimum else None


def _of_one_lens(lens: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Indices by lens, of those with at least three."""
    groups = [np.flatnonzero(lens == k) for k in np.unique(lens)]
    return [group for group in groups if len(group) >= 3]

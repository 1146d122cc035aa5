"""Planes aligned to the frames, which know better than rendered depth where a plane is.

A plane that is off by a little projects the texture of one frame beside that of another. This is the direct method of
Irani and Anandan, "About direct methods" (1999), for the three parameters of a plane: Gauss-Newton on differences of
luma between frames whose poses are known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.planes import Plane, depth_edges
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.photometric.warp import sample_points

Array = NDArray[np.float64]

#: Pixels whose depth is this near to a plane's are aligned with it; so many a view at most.
NEAR, PIXELS = 0.03, 750
#: Standard deviation of luma (of 1); iterations; other views for each.
SIGMA, ITERATIONS, OTHERS = 0.012, 8, 5
#: An alignment that moves the plane by more than this part of its distance from the views has failed.
FARTHEST_MOVE = 0.05


def align(plane: Plane, views: PosedPanoramas, generator: np.random.Generator) -> Plane | None:
    """The plane on which the frames agree, near ``plane``; None where they do not say.

    Pixels with much texture are few, and often they are what hangs on a wall. So each counts by the information that
    its gradient g has on the depth, but with a limit: the weight is 1 / (sigma^2 (1 + g^2 / median g^2)).
    """
    chosen = []
    for k in range(len(views)):
        rays = views.rays(k)
        near = np.abs(np.nan_to_num(plane.depth(rays, views.T_wc[k, :3, 3])) / views.depth[k] - 1) < NEAR
        near &= views.scale.valid & ~depth_edges(views.depth[k])
        rows, columns = np.nonzero(near)
        if len(rows) >= 100:
            some = generator.permutation(len(rows))[:PIXELS]
            chosen.append((k, rows[some], columns[some], rays[rows[some], columns[some]]))
    if not chosen:
        return None
    start = plane
    for _ in range(ITERATIONS):
        tangent, other = np.linalg.svd(plane.normal[None])[2][1:]
        A, b = np.zeros((3, 3)), np.zeros(3)
        for k, rows, columns, rays in chosen:
            centre = views.T_wc[k, :3, 3]
            slope = rays @ plane.normal
            depth = (plane.offset - plane.normal @ centre) / slope
            X = centre + depth[:, None] * rays
            by_depth = np.stack([1 / slope, -(X @ tangent) / slope, -(X @ other) / slope], axis=1)
            for j in views.others(k, OTHERS):
                g, residual, weight = _differences(views, j, X, depth, rays, views.luma[k][rows, columns])
                J = g[:, None] * by_depth
                A += J.T @ (weight[:, None] * J)
                b -= J.T @ (weight * residual)
        if not np.trace(A) > 0:
            return None
        step = np.linalg.solve(A + 1e-6 * np.trace(A) * np.eye(3), b)
        normal = plane.normal + step[1] * tangent + step[2] * other
        size = float(np.linalg.norm(normal))
        plane = Plane(normal / size, float(plane.offset + step[0]) / size)
    return plane if _moved(start, plane, chosen, views) < FARTHEST_MOVE else None


def _differences(
    views: PosedPanoramas, j: int, X: Array, depth: Array, rays: Array, luma: NDArray[np.float32]
) -> tuple[Array, Array, Array]:
    """Of points X (N, 3) at a depth (N,) along rays (N, 3), whose luma (N,) is known, in view ``j``: the derivative of
    its luma by the depth, the difference of luma but for its median, and the weight; each (N,), weight 0: not seen.
    """
    R, centre = views.T_wc[j, :3, :3], views.T_wc[j, :3, 3]
    local, along = (X - centre) @ R, 0.004 * depth[:, None] * (rays @ R)
    s, still = views.scale, np.eye(4)
    value, more, less = (
        sample_points(views.luma[j], local + sign * along, still, s.code, s.cam).astype(np.float64)
        for sign in (0, 1, -1)
    )
    g = (more - less) / (0.008 * depth)
    residual = value - luma
    mapped = sample_points(views.depth[j], local, still, s.code, s.cam)
    seen = np.abs(mapped / np.linalg.norm(local, axis=1) - 1) < 2 * NEAR
    seen &= np.isfinite(g) & np.isfinite(residual)
    if seen.sum() < 20:
        zero = np.zeros(len(X))
        return zero, zero, zero
    g, residual = np.where(seen, g, 0.0), np.where(seen, residual - np.median(residual[seen]), 0.0)
    usual = float(np.median(np.abs(g[seen]))) + 1e-9
    weight = seen / (1 + (g / usual) ** 2) / (1 + (residual / (2 * SIGMA)) ** 2) / SIGMA**2
    return g, residual, weight


def _moved(
    before: Plane,
    after: Plane,
    chosen: list[tuple[int, NDArray[np.int64], NDArray[np.int64], Array]],
    views: PosedPanoramas,
) -> float:
    """Median change of the depth where the plane was seen, over that depth."""
    changes = [
        np.abs(after.depth(rays, views.T_wc[k, :3, 3]) / before.depth(rays, views.T_wc[k, :3, 3]) - 1)
        for k, _, _, rays in chosen
    ]
    joined = np.nan_to_num(np.concatenate(changes), nan=1.0)
    return float(np.median(joined))

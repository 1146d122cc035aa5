"""Frame-to-map tracking: predict, align patches coarse to fine, solve the pose."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.methods.sparse.adjust import pose_errors, solve_pose
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.faces import FaceRig
from panobench.methods.sparse.patches import align_level
from panobench.methods.sparse.pointmap import ACTIVE, CANDIDATE, DEAD, PointMap

Array = NDArray[np.float64]
Pyramid = list[NDArray[np.uint8]]

#: Largest shift per level, in that level's pixels, coarsest first; the finest only polishes.
LIMITS = (8.0, 4.0, 4.0, 3.0)
#: Least share of the aligned patches that must agree on the pose.
AGREEING = 0.6
#: Most points aligned per frame.
BUDGET = 1200


@dataclass
class Tracked:
    """Pose and measurements of one frame; ``points`` are the inliers, ``candidates`` still without a depth."""

    T_cw: Array
    points: NDArray[np.int64]
    bearings: Array
    candidates: NDArray[np.int64]
    candidate_bearings: Array
    tried: int
    error_px: float


def predict(T_cw: Array, positions: Array) -> Array:
    """Unit bearings (N, 3) of world points."""
    p = positions @ T_cw[:3, :3].T + T_cw[:3, 3]
    return np.asarray(p / np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-12))


@dataclass
class Aligner:
    """Aligns map points to one frame's faces."""

    rig: FaceRig
    config: SparseConfig
    map: PointMap
    pool: Executor | None = None

    def run(
        self,
        pyramid: Pyramid,
        T_cw: Array,
        points: NDArray[np.int64],
        bearings: Array,
        ok: NDArray[np.bool_],
        level: int,
    ) -> Array:
        """One level for map points, in place on bearings and ok; returns the ZNCC (N,)."""
        m = self.map
        return align_level(
            self.pool,
            pyramid[level],
            self.rig.valid,
            level,
            self.rig.R_fc,
            self.rig.intrinsics,
            self.rig.focal,
            m.template[points, level],
            m.anchor_bearing[points],
            m.inverse_distance(points),
            T_cw @ invert_pose(m.poses()),
            m.anchor[points],
            bearings,
            ok,
            LIMITS[min(len(pyramid) - 1 - level, len(LIMITS) - 1)],
        )


def choose_points(
    m: PointMap, rig: FaceRig, T_cw: Array, frame: int, only: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """Points worth trying: alive, projecting into a face, the recently seen first."""
    alive = np.flatnonzero(m.state != DEAD) if only is None else only[m.state[only] != DEAD]
    stale = (m.visible[alive] > 20) & (m.found[alive] < 0.15 * m.visible[alive])
    alive = alive[~stale]
    if len(alive) == 0:
        return alive
    b = predict(T_cw, m.position[alive])
    alive = alive[in_view(rig, b)]
    if len(alive) <= BUDGET:
        return alive
    age = frame - m.last_seen[alive]
    # Recent ones in order of age; ties (all seen in the last frame) by how reliably they are found.
    quality = m.found[alive] / np.maximum(m.visible[alive], 1)
    order = np.lexsort((-quality, age))
    return np.sort(alive[order[:BUDGET]])


def in_view(rig: FaceRig, bearings: Array) -> NDArray[np.bool_]:
    """(N,): the bearing falls on a valid pixel of its nearest face."""
    face = np.argmax(bearings @ rig.R_fc[:, 2].T, axis=1)
    p = np.einsum("nij,nj->ni", rig.R_fc[face], bearings)
    fx, fy, cx, cy = rig.intrinsics
    z = np.maximum(p[:, 2], 1e-6)
    u, v = fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy
    h, w = rig.size
    inside = (p[:, 2] > 0.1) & (u > 1) & (v > 1) & (u < w - 1) & (v < h - 1)
    out = np.zeros(len(bearings), bool)
    out[inside] = rig.valid[face[inside], v[inside].astype(int), u[inside].astype(int)]
    return out


def track_frame(
    aligner: Aligner,
    pyramid: Pyramid,
    T_pred: Array,
    frame: int,
    min_inliers: int,
    only: NDArray[np.int64] | None = None,
) -> Tracked | None:
    """Pose of a frame near ``T_pred``, or None when too few points agree. Updates the points' statistics.

    only: points to try (default: the whole map).
    """
    m, rig, config = aligner.map, aligner.rig, aligner.config
    points = choose_points(m, rig, T_pred, frame, only)
    active = m.state[points] == ACTIVE
    if int(active.sum()) < min_inliers:
        return None
    top = len(pyramid) - 1
    bearings = predict(T_pred, m.position[points])
    ok = np.ones(len(points), bool)
    T = T_pred
    if top > 0:
        score = aligner.run(pyramid, T_pred, points, bearings, ok, top)
        good = ok & active & (score > 0.6)
        if int(good.sum()) >= min_inliers:
            T = solve_pose(T_pred, m.position[points[good]], bearings[good], rig.focal, 4.0, 12)
        # Points the coarse level lost start again from the better pose; candidates keep what they measured.
        fresh = predict(T, m.position[points])
        restart = active | ~ok | (score < 0.6)
        bearings[restart] = fresh[restart]
        ok[:] = True
    score = np.zeros(len(points))
    # The coarse pose leaves a pixel or two: the finest levels are enough.
    for level in range(min(max(top - 1, 0), 1), -1, -1):
        score = aligner.run(pyramid, T, points, bearings, ok, level)
    ok &= score > config.min_zncc
    use = np.flatnonzero(ok & active)
    if len(use) < min_inliers:
        return None
    X, b = m.position[points[use]], bearings[use]
    T = solve_pose(T, X, b, rig.focal, config.huber_px, 15)
    error = pose_errors(T, X, b, rig.focal)
    inlier = error < 3.0 * max(1.0, config.huber_px)
    if int(inlier.sum()) < min_inliers:
        return None
    T = solve_pose(T, X[inlier], b[inlier], rig.focal, config.huber_px, 10)
    error = pose_errors(T, X, b, rig.focal)
    inlier = error < 3.0 * max(1.0, config.huber_px)
    # A wrong pose near the right one also aligns some patches; a right one aligns most of those it can.
    if int(inlier.sum()) < max(min_inliers, int(AGREEING * len(use))):
        return None
    found = use[inlier]
    waiting = np.flatnonzero(ok & (m.state[points] == CANDIDATE))
    waiting = waiting[_on_epipolar_plane(m, points[waiting], bearings[waiting], T, rig.focal)]
    m.visible[points] += 1
    m.misses[points] += 1
    for index in (found, waiting):
        ids = points[index]
        m.found[ids] += 1
        m.misses[ids] = 0
        m.last_seen[ids] = frame
        m.bearing[ids] = bearings[index]
    return Tracked(
        T,
        points[found],
        bearings[found],
        points[waiting],
        bearings[waiting],
        int(active.sum()),
        float(np.median(error)),
    )


def _on_epipolar_plane(
    m: PointMap, points: NDArray[np.int64], bearings: Array, T_cw: Array, focal: float
) -> NDArray[np.bool_]:
    """Candidates whose measurement agrees with the camera's motion within 2 pixels (or is nearly the epipole)."""
    if len(points) == 0:
        return np.zeros(0, bool)
    rel = T_cw @ invert_pose(m.poses())[m.anchor[points]]
    t = rel[:, :3, 3]
    turned = np.einsum("nij,nj->ni", rel[:, :3, :3], m.anchor_bearing[points])
    normal = np.cross(t, turned)
    length = np.linalg.norm(normal, axis=1)
    off = np.abs(np.sum(normal * bearings, axis=1)) / np.maximum(length, 1e-12)
    unsure = length < 1e-3 * np.maximum(np.linalg.norm(t, axis=1), 1e-12)
    direct = np.linalg.norm(turned - bearings, axis=1)
    return np.asarray(np.where(unsure, direct < 4 / focal, off < 2.0 / focal))


def update_candidates(m: PointMap, tracked: Tracked) -> None:
    """Move candidates' assumed positions to where the widest parallax so far puts them."""
    ids, b = tracked.candidates, tracked.candidate_bearings
    if len(ids) == 0:
        return
    from panobench.methods.sparse.mapping import ray_distance

    rel = tracked.T_cw @ invert_pose(m.poses())[m.anchor[ids]]
    distance, angle = ray_distance(m.anchor_bearing[ids], b, rel[:, :3, :3], rel[:, :3, 3])
    better = (angle > m.parallax[ids]) & (angle > 0.003) & (distance > 0)
    ids, distance = ids[better], distance[better]
    T_wa = invert_pose(m.poses())[m.anchor[ids]]
    m.position[ids] = (
        np.einsum("nij,nj->ni", T_wa[:, :3, :3], m.anchor_bearing[ids] * distance[:, None]) + T_wa[:, :3, 3]
    )
    m.parallax[ids] = angle[better]

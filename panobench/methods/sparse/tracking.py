"""Frame-to-map tracking: prediction, patch alignment from coarse to fine, and pose optimisation."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.inertial.rotation_prior import RotationPrior
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.faces import FaceSet
from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.patches import align_level
from panobench.methods.sparse.pointmap import ACTIVE, CANDIDATE, DEAD, PointMap
from panobench.methods.sparse.pose import pose_errors, solve_pose

Array = NDArray[np.float64]
Pyramid = list[NDArray[np.uint8]]

#: Largest shift per level in that level's pixels, coarsest level first.
LIMITS = (8.0, 4.0, 4.0, 3.0)
#: Least share of the aligned patches that must be inliers of the pose.
MIN_INLIER_SHARE = 0.6
#: Most points aligned per frame.
MAX_ALIGNED = 1200


@dataclass
class Tracked:
    """Pose and measurements of a frame. ``points`` are the inliers, ``candidates`` have no depth yet."""

    T_cw: Array
    points: NDArray[np.int64]
    bearings: Array
    candidates: NDArray[np.int64]
    candidate_bearings: Array
    tried: int
    error_px: float


def predict(T_cw: Array, positions: Array, lenses: Lenses) -> Array:
    """Unit bearings (N, 3) of world points (N, 3)."""
    return lenses.bearings(positions @ T_cw[:3, :3].T + T_cw[:3, 3])


@dataclass
class Aligner:
    """Aligns the templates of map points to a frame's faces. exact: as of ``align_level``."""

    face_set: FaceSet
    config: SparseConfig
    map: PointMap
    pool: Executor | None = None
    exact: bool = False

    def run(
        self,
        pyramid: Pyramid,
        T_cw: Array,
        points: NDArray[np.int64],
        bearings: Array,
        ok: NDArray[np.bool_],
        level: int,
    ) -> Array:
        """Align on one level: updates bearings and ok in place, returns the ZNCC (N,)."""
        m, lenses = self.map, self.face_set.lenses
        before = lenses.of(bearings) if lenses.several else None
        score = align_level(
            self.pool,
            pyramid[level],
            self.face_set.valid,
            level,
            self.face_set.R_fc,
            self.face_set.intrinsics,
            self.face_set.focal,
            m.templates_on(points, level),
            m.anchor_bearing[points],
            m.inverse_distance(points),
            *self._motion(T_cw, points, bearings),
            bearings,
            ok,
            LIMITS[min(len(pyramid) - 1 - level, len(LIMITS) - 1)],
            self.exact,
        )
        if before is not None:  # measured in the picture of a lens that it left
            ok &= lenses.of(bearings) == before
        return score

    def _motion(self, T_cw: Array, points: NDArray[np.int64], bearings: Array) -> tuple[Array, NDArray[np.int64]]:
        """Motions (M, 4, 4) from the points' anchors to the camera, and which one is each point's (N,).

        Of a rig they are those between the lens of the template and the lens of the prediction.
        """
        m, lenses = self.map, self.face_set.lenses
        relative = T_cw @ invert_pose(m.poses())
        anchor = m.anchor[points]
        if not lenses.several:
            return relative, anchor
        moved = relative[anchor]
        moved[:, :3, 3] = lenses.between(moved, m.anchor_bearing[points], bearings)
        return moved, np.arange(len(points))


def choose_points(
    m: PointMap, face_set: FaceSet, T_cw: Array, frame: int, only: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """The points to align: not dead, in view, and those seen most recently if there are too many."""
    alive = np.flatnonzero(m.state != DEAD) if only is None else only[m.state[only] != DEAD]
    stale = (m.visible[alive] > 20) & (m.found[alive] < 0.15 * m.visible[alive])
    alive = alive[~stale]
    if len(alive) == 0:
        return alive
    b = predict(T_cw, m.position[alive], face_set.lenses)
    view = in_view(face_set, b)
    if face_set.lenses.several:
        view &= face_set.lenses.sees(m.position[alive] @ T_cw[:3, :3].T + T_cw[:3, 3])
    alive = alive[view]
    if len(alive) <= MAX_ALIGNED:
        return alive
    age = frame - m.last_seen[alive]
    # By how recently they were seen; of those seen in the same frame, the ones found most reliably.
    quality = m.found[alive] / np.maximum(m.visible[alive], 1)
    order = np.lexsort((-quality, age))
    return np.sort(alive[order[:MAX_ALIGNED]])


def in_view(face_set: FaceSet, bearings: Array) -> NDArray[np.bool_]:
    """(N,): whether a bearing projects to a valid pixel of its nearest face."""
    face = np.argmax(bearings @ face_set.R_fc[:, 2].T, axis=1)
    p = np.einsum("nij,nj->ni", face_set.R_fc[face], bearings)
    fx, fy, cx, cy = face_set.intrinsics
    z = np.maximum(p[:, 2], 1e-6)
    u, v = fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy
    h, w = face_set.size
    inside = (p[:, 2] > 0.1) & (u > 1) & (v > 1) & (u < w - 1) & (v < h - 1)
    out = np.zeros(len(bearings), bool)
    out[inside] = face_set.valid[face[inside], v[inside].astype(int), u[inside].astype(int)]
    return out


def track_frame(
    aligner: Aligner,
    pyramid: Pyramid,
    T_pred: Array,
    frame: int,
    min_inliers: int,
    only: NDArray[np.int64] | None = None,
    prior: RotationPrior | None = None,
) -> Tracked | None:
    """Pose of a frame near ``T_pred``, None with too few inliers. Updates the points' statistics.

    only: the points to use; by default the whole map. prior: what a gyroscope knows of the rotation.
    """
    m, face_set, config = aligner.map, aligner.face_set, aligner.config
    points = choose_points(m, face_set, T_pred, frame, only)
    active = m.state[points] == ACTIVE
    if int(active.sum()) < min_inliers:
        return None
    top = len(pyramid) - 1
    lenses = face_set.lenses
    bearings = predict(T_pred, m.position[points], lenses)
    ok = np.ones(len(points), bool)
    T = T_pred
    if top > 0:
        score = aligner.run(pyramid, T_pred, points, bearings, ok, top)
        good = ok & active & (score > 0.6)
        if int(good.sum()) >= min_inliers:
            seen = bearings[good]
            X, begin = m.position[points[good]], lenses.origins(seen)
            T = solve_pose(T_pred, X, seen, face_set.focal, 4.0, 12, begin, prior)
        # Points that the coarse level lost are predicted again with the better pose; candidates keep their measurement.
        fresh = predict(T, m.position[points], lenses)
        restart = active | ~ok | (score < 0.6)
        bearings[restart] = fresh[restart]
        ok[:] = True
    score = np.zeros(len(points))
    # After the coarse pose, errors are one or two pixels: the finest levels are enough.
    for level in range(min(max(top - 1, 0), 1), -1, -1):
        score = aligner.run(pyramid, T, points, bearings, ok, level)
    ok &= score > config.min_zncc
    use = np.flatnonzero(ok & active)
    if len(use) < min_inliers:
        return None
    X, b = m.position[points[use]], bearings[use]
    begin = lenses.origins(b)
    T = solve_pose(T, X, b, face_set.focal, config.huber_px, 15, begin, prior)
    error = pose_errors(T, X, b, face_set.focal, begin)
    inlier = error < 3.0 * max(1.0, config.huber_px)
    if int(inlier.sum()) < min_inliers:
        return None
    kept = None if begin is None else begin[inlier]
    T = solve_pose(T, X[inlier], b[inlier], face_set.focal, config.huber_px, 10, kept, prior)
    error = pose_errors(T, X, b, face_set.focal, begin)
    inlier = error < 3.0 * max(1.0, config.huber_px)
    # A pose that is slightly wrong also aligns some patches; the right one aligns most of them.
    if int(inlier.sum()) < max(min_inliers, int(MIN_INLIER_SHARE * len(use))):
        return None
    found = use[inlier]
    waiting = np.flatnonzero(ok & (m.state[points] == CANDIDATE))
    waiting = waiting[_on_epipolar_plane(m, points[waiting], bearings[waiting], T, face_set.focal)]
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
    """Candidates whose measurement is within 2 pixels of the epipolar plane, or close to the epipole."""
    if len(points) == 0:
        return np.zeros(0, bool)
    rel = T_cw @ invert_pose(m.poses())[m.anchor[points]]
    t = m.lenses.between(rel, m.anchor_bearing[points], bearings)
    turned = np.einsum("nij,nj->ni", rel[:, :3, :3], m.anchor_bearing[points])
    normal = np.cross(t, turned)
    length = np.linalg.norm(normal, axis=1)
    off = np.abs(np.sum(normal * bearings, axis=1)) / np.maximum(length, 1e-12)
    unsure = length < 1e-3 * np.maximum(np.linalg.norm(t, axis=1), 1e-12)
    direct = np.linalg.norm(turned - bearings, axis=1)
    return np.asarray(np.where(unsure, direct < 4 / focal, off < 2.0 / focal))


def update_candidates(m: PointMap, tracked: Tracked) -> None:
    """Triangulate candidates again if this frame has the largest parallax so far."""
    ids, b = tracked.candidates, tracked.candidate_bearings
    if len(ids) == 0:
        return
    from panobench.methods.sparse.mapping import ray_distance

    rel = tracked.T_cw @ invert_pose(m.poses())[m.anchor[ids]]
    t = m.lenses.between(rel, m.anchor_bearing[ids], b)
    distance, angle = ray_distance(m.anchor_bearing[ids], b, rel[:, :3, :3], t)
    better = (angle > m.parallax[ids]) & (angle > 0.003) & (distance > 0)
    ids, distance = ids[better], distance[better]
    T_wa = invert_pose(m.poses())[m.anchor[ids]]
    m.position[ids] = m.lenses.places(T_wa, m.anchor_bearing[ids], distance)
    m.parallax[ids] = angle[better]

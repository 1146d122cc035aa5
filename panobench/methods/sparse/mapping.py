"""Mapping at keyframes: new points, triangulation, local bundle adjustment and templates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from panobench.geometry import invert_pose
from panobench.methods.sparse.bundle import bundle_adjust
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.descriptors import describe
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.faces import FaceSet
from panobench.methods.sparse.pointmap import ACTIVE, CANDIDATE, DEAD, Keyframe, PointMap
from panobench.methods.sparse.pose import deviation

Array = NDArray[np.float64]

#: Observations with a residual of so many deviations after bundle adjustment are dropped, but none below the first and
#: all above the second number of pixels.
OUTLIER_SIGMAS, OUTLIER_PX = 5.0, (1.0, 3.0)
#: Most fixed keyframes outside the window in a local bundle adjustment.
MAX_FIXED = 10


def ray_distance(b1: Array, b2: Array, R: Array, t: Array) -> tuple[Array, Array]:
    """Distance along bearings b1 (N, 3) to the rays b2 (N, 3) of a second camera, and the angle (N,) between the rays.

    x2 = R x1 + t with R (N, 3, 3), t (N, 3). The distance is negative where the rays meet behind the camera, and 0
    where they are parallel.
    """
    r = np.einsum("nij,nj->ni", R, b1)
    cross = np.cross(b2, r)
    angle = np.arctan2(np.linalg.norm(cross, axis=1), np.sum(r * b2, axis=1))
    # s r + t is parallel to b2, so s (b2 x r) = -(b2 x t), solved by least squares.
    denom = np.sum(cross * cross, axis=1)
    s = -np.sum(cross * np.cross(b2, t), axis=1) / np.maximum(denom, 1e-18)
    return np.where(denom > 1e-14, s, 0.0), angle


def add_candidates(
    m: PointMap, face_set: FaceSet, config: SparseConfig, pyramid: list[NDArray[np.uint8]], keyframe: Keyframe
) -> int:
    """Detect corners where the keyframe has none, and add them as candidates at their neighbours' depth."""
    seen = keyframe.bearings
    wanted = config.features - len(seen)
    fresh = detect_corners(face_set, pyramid[0], wanted, seen)
    if len(fresh) == 0:
        return 0
    T_wc = invert_pose(keyframe.T_cw)
    known = m.state[keyframe.points] == ACTIVE
    distance = np.full(len(fresh), 2.0)
    if int(known.sum()) >= 3:
        depth = np.linalg.norm(m.position[keyframe.points[known]] - T_wc[:3, 3], axis=1)
        gap, near = cKDTree(seen[known]).query(fresh, k=3)
        weight = 1.0 / (gap + 1e-3)
        distance = np.sum(weight, axis=1) / np.sum(weight / depth[near], axis=1)
    templates = face_set.templates(pyramid, fresh)
    ids = m.add(
        len(fresh),
        state=CANDIDATE,
        anchor=keyframe.number,
        anchor_bearing=fresh,
        bearing=fresh,
        last_seen=keyframe.frame,
        position=_placed(m, T_wc, fresh, distance),
        template=templates,
        descriptor=describe(templates),
    )
    keyframe.points = np.concatenate([keyframe.points, ids])
    keyframe.bearings = np.concatenate([keyframe.bearings, fresh])
    return len(fresh)


def _placed(m: PointMap, T_wc: Array, bearings: Array, distance: Array) -> Array:
    """World points (N, 3) along bearings (N, 3) of one camera."""
    local = bearings * distance[:, None]
    origins = m.lenses.origins(bearings)
    return np.asarray((local if origins is None else local + origins) @ T_wc[:3, :3].T + T_wc[:3, 3])


def promote_candidates(m: PointMap, config: SparseConfig, keyframe: Keyframe) -> int:
    """Triangulate the candidates that this keyframe sees with enough parallax to their anchor keyframe."""
    mine = np.flatnonzero(m.state[keyframe.points] == CANDIDATE)
    mine = mine[m.anchor[keyframe.points[mine]] != keyframe.number]
    if len(mine) == 0:
        return 0
    ids = keyframe.points[mine]
    T_wa = invert_pose(m.poses())[m.anchor[ids]]
    rel = keyframe.T_cw @ T_wa
    t = m.lenses.between(rel, m.anchor_bearing[ids], keyframe.bearings[mine])
    distance, angle = ray_distance(m.anchor_bearing[ids], keyframe.bearings[mine], rel[:, :3, :3], t)
    good = (distance > 0) & (angle > np.deg2rad(config.min_parallax))
    ids, distance, T_wa = ids[good], distance[good], T_wa[good]
    m.position[ids] = m.lenses.places(T_wa, m.anchor_bearing[ids], distance)
    m.state[ids] = ACTIVE
    return len(ids)


def drop_lost_candidates(m: PointMap, misses: int = 3) -> None:
    """Remove candidates that were missed in several frames in a row."""
    dead = (m.state == CANDIDATE) & (m.misses >= misses)
    m.state[dead] = DEAD


def adjust_window(
    m: PointMap,
    config: SparseConfig,
    focal: float,
    members: list[int],
    iterations: int,
    free_scale: bool = False,
    settled: bool = True,
) -> float:
    """Bundle adjustment of some keyframes and the points they see. Other keyframes that see the points are fixed.

    Drops outlier observations, and points with fewer than two observations left. Returns the RMS in pixels. The scale
    of a rig's map, which a few keyframes hardly tell, is held by the first two unless it is to be free. Unless the map
    is ``settled``, as it is not after a loop, residuals of a few deviations may be right, and stay.
    """
    chosen = np.zeros(m.size, bool)
    for number in members:
        chosen[m.keyframes[number].points] = True
    chosen &= m.state == ACTIVE
    seen = observations(_observing_keyframes(m, members, chosen), chosen)
    if seen is None:
        return 0.0
    kf, pt, b, at = seen
    numbers, kf_local = np.unique(kf, return_inverse=True)
    ids, pt_local = np.unique(pt, return_inverse=True)
    fixed = ~np.isin(numbers, members)
    if not fixed.any():
        fixed[np.argmin(numbers)] = True  # fixes the gauge
        if m.lenses.several and not free_scale and len(numbers) > 1:
            fixed[np.argsort(numbers)[1]] = True
    T = m.poses()[numbers]
    origins = m.lenses.origins(b)
    result = bundle_adjust(
        T, m.position[ids], kf_local, pt_local, b, fixed, focal, config.huber_px, iterations, origins
    )
    m.position[ids] = result.points
    for number, pose, held in zip(numbers, result.T_cw, fixed):
        if not held:
            m.keyframes[number].T_cw = pose
    least, most = OUTLIER_PX
    outlier = result.errors > (np.clip(OUTLIER_SIGMAS * deviation(result.errors), least, most) if settled else most)
    for number in np.unique(kf[outlier]):
        key = m.keyframes[number]
        lost = np.zeros(len(key.points), bool)
        lost[at[outlier & (kf == number)]] = True
        key.drop(lost)
    m.state[ids[m.observation_counts()[ids] < 2]] = DEAD
    inliers = result.errors[~outlier]
    return float(np.sqrt(np.mean(inliers**2))) if len(inliers) else 0.0


def observations(
    keyframes: list[Keyframe], chosen: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, NDArray[np.int64]] | None:
    """What keyframes saw of the ``chosen`` (N,) points: the keyframe's number, the point, its bearing (M, 3), and where
    in the keyframe that observation is; None if they saw none.
    """
    use = [(k, np.flatnonzero(chosen[k.points])) for k in keyframes]
    use = [(k, at) for k, at in use if len(at)]
    if not use:
        return None
    return (
        np.concatenate([np.full(len(at), k.number) for k, at in use]),
        np.concatenate([k.points[at] for k, at in use]),
        np.concatenate([k.bearings[at] for k, at in use]),
        np.concatenate([at for _, at in use]),
    )


def _observing_keyframes(m: PointMap, members: list[int], chosen: NDArray[np.bool_]) -> list[Keyframe]:
    """The members, and some of the other keyframes that see the points, spread over time.

    Nearly all keyframes see a panorama's points, and a dozen fixed ones do as well as a hundred.
    """
    inside = set(members)
    others = [k for k in m.keyframes if k.number not in inside and int(chosen[k.points].sum()) >= 15]
    if len(others) > MAX_FIXED:
        others = [others[i] for i in np.linspace(0, len(others) - 1, MAX_FIXED).round().astype(int)]
    return sorted([*(m.keyframes[i] for i in members), *others], key=lambda k: k.number)


def local_window(m: PointMap, newest: int, size: int) -> list[int]:
    """The newest keyframe and those that share most active points with it."""
    seen = np.zeros(m.size, bool)
    seen[m.keyframes[newest].points] = True
    seen &= m.state == ACTIVE
    shared = np.array([int(seen[k.points].sum()) for k in m.keyframes])
    shared[newest] = np.iinfo(np.int64).max
    # Of equally connected keyframes the recent ones, whose poses have been refined least.
    recent = np.arange(len(shared))
    order = np.lexsort((-recent, -np.minimum(shared, max(1, int(0.5 * seen.sum())))))
    order = np.concatenate([[newest], order[order != newest]])
    return sorted(int(k) for k in order[:size] if shared[k] >= 10)


def renew_templates(
    m: PointMap, face_set: FaceSet, pyramid: list[NDArray[np.uint8]], keyframe: Keyframe, max_angle: float = 25.0
) -> None:
    """Cut new templates for points that are seen at another angle or scale than in their template."""
    ids = keyframe.points
    use = (m.state[ids] == ACTIVE) & (m.anchor[ids] != keyframe.number)
    ids, b = ids[use], keyframe.bearings[use]
    if len(ids) == 0:
        return
    centres = m.centres()
    then = m.position[ids] - centres[m.anchor[ids]]
    now = m.position[ids] - centres[keyframe.number]
    d0, d1 = np.linalg.norm(then, axis=1), np.linalg.norm(now, axis=1)
    angle = np.degrees(np.arccos(np.clip(np.sum(then * now, axis=1) / (d0 * d1), -1, 1)))
    stale = (angle > max_angle) | (d1 < 0.65 * d0) | (d1 > 1.6 * d0)
    ids, b = ids[stale], b[stale]
    if len(ids) == 0:
        return
    templates = face_set.templates(pyramid, b)
    m.renew_templates(ids, templates)
    m.descriptor[ids] = describe(templates)
    m.anchor[ids] = keyframe.number
    m.anchor_bearing[ids] = b

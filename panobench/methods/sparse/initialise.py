"""Map initialisation: corners of a reference frame are tracked until two-view geometry has enough parallax."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import make_pose
from panobench.methods.sparse.bundle import bundle_adjust
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.descriptors import describe
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.faces import FaceSet
from panobench.methods.sparse.mapping import ray_distance
from panobench.methods.sparse.patches import align_level
from panobench.methods.sparse.pointmap import ACTIVE, CANDIDATE, DEAD, Keyframe, PointMap
from panobench.methods.sparse.pose import pose_errors, solve_pose
from panobench.methods.sparse.tracking import LIMITS, Pyramid
from panobench.methods.sparse.twoview import essential_ransac

Array = NDArray[np.float64]

#: The first map is scaled to this median distance of its points.
MEDIAN_DISTANCE = 2.0


@dataclass
class InitialFrame:
    """A frame before there is a map: its rotation from the reference, the tracks it saw, and their bearings."""

    index: int
    time: float
    mappable: bool
    rotation: Array
    tracks: NDArray[np.int64]
    bearings: Array


@dataclass
class Initialiser:
    """Tracks corners of one reference frame. ``add`` returns a map as soon as two views give one.

    exact: as of ``align_level``.
    """

    face_set: FaceSet
    config: SparseConfig
    rng: np.random.Generator
    pool: Executor | None = None
    exact: bool = False
    history: list[InitialFrame] = field(default_factory=list)

    def reset(self) -> None:
        self.history = []

    def _start(self, pyramid: Pyramid, index: int, time: float) -> None:
        corners = detect_corners(self.face_set, pyramid[0], self.config.features, np.empty((0, 3)))
        if len(corners) < 2 * self.config.min_inliers:
            return
        self.anchors = corners
        self.templates = self.face_set.templates(pyramid, corners)
        self.current = corners.copy()
        self.alive = np.ones(len(corners), bool)
        self.history = [InitialFrame(index, time, True, np.eye(3), np.arange(len(corners)), corners.copy())]

    def add(
        self, pyramid: Pyramid, index: int, time: float, mappable: bool, R_prior: Array
    ) -> tuple[PointMap, list[InitialFrame]] | None:
        """The map and its frames, or None if more are needed. ``R_prior`` is the rotation from the frame before."""
        if not self.history:
            if mappable:
                self._start(pyramid, index, time)
            return None
        R = self._follow(pyramid, R_prior)
        if R is None:
            self.reset()
            if mappable:
                self._start(pyramid, index, time)
            return None
        tracks = np.flatnonzero(self.alive)
        self.history.append(InitialFrame(index, time, mappable, R, tracks, self.current[tracks].copy()))
        turned = self.anchors[tracks] @ R.T
        parallax = np.degrees(np.arccos(np.clip(np.sum(turned * self.current[tracks], axis=1), -1, 1)))
        # In a narrow view sideways translation looks like rotation, which hides the parallax. When corners leave the
        # view, two-view geometry is tried earlier, and its own parallax decides.
        leaving = len(tracks) < 0.7 * len(self.anchors)
        needed = self.config.init_parallax * (0.1 if leaving else 1.0)
        if mappable and float(np.median(parallax)) > needed:
            built = self._build(pyramid)
            if built is not None:
                return built, self.history
        if len(tracks) < max(2 * self.config.min_inliers, 0.25 * len(self.anchors)):
            self.reset()
            if mappable:
                self._start(pyramid, index, time)
        return None

    def _follow(self, pyramid: Pyramid, R_prior: Array) -> Array | None:
        """Track all corners into the frame. Returns its rotation from the reference, None if too few are left."""
        last = self.history[-1].rotation
        R = R_prior @ last
        bearings = self.current @ R_prior.T
        ok = self.alive.copy()
        score = np.zeros(len(ok))
        zero = np.zeros(len(ok), np.int64)
        for level in range(len(pyramid) - 1, -1, -1):
            before = ok.copy()
            kept = bearings.copy()
            lens = self.face_set.lenses.of(bearings)
            score = align_level(
                self.pool,
                pyramid[level],
                self.face_set.valid,
                level,
                self.face_set.R_fc,
                self.face_set.intrinsics,
                self.face_set.focal,
                np.ascontiguousarray(self.templates[:, level]),
                self.anchors,
                np.zeros(len(ok)),
                make_pose(R, np.zeros(3))[None],
                zero,
                bearings,
                ok,
                LIMITS[min(len(pyramid) - 1 - level, len(LIMITS) - 1)] * (1.5 if level else 1.0),
                self.exact,
            )
            if self.face_set.lenses.several:  # measured in the picture of a lens that it left
                ok &= self.face_set.lenses.of(bearings) == lens
            if level > 0:  # corners without texture on a coarse level stay where they were
                failed = before & (~ok | (score < 0.5))
                bearings[failed] = kept[failed]
                ok = before
                use = ok & ~failed
                if int(use.sum()) >= self.config.min_inliers:
                    R = _robust_rotation(self.anchors[use], bearings[use])
        ok &= score > self.config.min_zncc
        if int(ok.sum()) < self.config.min_inliers:
            return None
        self.alive, self.current = ok, bearings
        return _robust_rotation(self.anchors[ok], bearings[ok])

    def _build(self, pyramid: Pyramid) -> PointMap | None:
        focal = self.face_set.focal
        last = self.history[-1]
        start = self._two_views(last)
        if start is None:
            return None
        T_last, points, tracks = start
        frames = self._intermediate_frames()
        T = [np.eye(4), *self._intermediate_poses(frames, points, tracks, T_last), T_last]
        chosen = [0, *frames, len(self.history) - 1]
        slot = np.full(len(self.anchors), -1)
        slot[tracks] = np.arange(len(tracks))
        kf, pt, b = [], [], []
        for k, g in enumerate(chosen):
            use = slot[self.history[g].tracks] >= 0
            kf.append(np.full(int(use.sum()), k))
            pt.append(slot[self.history[g].tracks[use]])
            b.append(self.history[g].bearings[use])
        kfs, pts, bs = np.concatenate(kf), np.concatenate(pt), np.concatenate(b)
        fixed = np.zeros(len(chosen), bool)
        fixed[0] = True
        origins = self.face_set.lenses.origins(bs)
        result = bundle_adjust(np.stack(T), points, kfs, pts, bs, fixed, focal, self.config.huber_px, 20, origins)
        worst = np.zeros(len(points))
        np.maximum.at(worst, pts, result.errors)
        centre = -result.T_cw[-1, :3, :3].T @ result.T_cw[-1, :3, 3]
        angle = np.degrees(_angle_between(result.points, result.points - centre))
        ahead = np.sum(result.points * self.anchors[tracks], axis=1) > 0
        good = (worst < 2.0) & (angle > 0.6 * self.config.min_parallax) & ahead
        if int(good.sum()) < 2 * self.config.min_inliers or float(np.median(angle[good])) < self.config.min_parallax:
            return None
        scale = MEDIAN_DISTANCE / float(np.median(np.linalg.norm(result.points[good], axis=1)))
        return self._make_map(result.points * scale, tracks, good, result.T_cw, chosen, scale)

    def _two_views(self, last: InitialFrame) -> tuple[Array, Array, NDArray[np.int64]] | None:
        """T_cw (4, 4) of the last frame, points (P, 3) and their tracks (P,), at a median distance of two."""
        lenses, focal = self.face_set.lenses, self.face_set.focal
        tracks, b2 = last.tracks, last.bearings
        if lenses.several:  # the essential matrix is that of one lens, the one that sees most tracks in both frames
            own, now = lenses.of(self.anchors[tracks]), lenses.of(b2)
            most = int(np.argmax(np.bincount(own[own == now], minlength=len(lenses.centres))))
            one = (own == most) & (now == most)
            tracks, b2 = tracks[one], b2[one]
        b1 = self.anchors[tracks]
        two = essential_ransac(b1, b2, 1.5 / focal, self.rng, 200, np.deg2rad(0.3))
        if two is None or int(two.inliers.sum()) < max(2 * self.config.min_inliers, 0.5 * len(b1)):
            return None
        tracks, points = tracks[two.inliers], two.points[two.inliers]
        scale = MEDIAN_DISTANCE / float(np.median(np.linalg.norm(points, axis=1)))
        points, t = points * scale, two.t * scale
        if not lenses.several:
            return make_pose(two.R, t), points, tracks
        centre = lenses.centres[most]
        T_last = make_pose(two.R, t + centre - two.R @ centre)
        points, others = points + centre, np.setdiff1d(last.tracks, tracks)
        more, placed = self._seen_by_others(last, T_last, others)
        return T_last, np.concatenate([points, more]), np.concatenate([tracks, placed])

    def _seen_by_others(
        self, last: InitialFrame, T_last: Array, tracks: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.int64]]:
        """Points (P, 3) of tracks that a rig's other lenses see, from a motion that is known, and these tracks."""
        lenses = self.face_set.lenses
        b1, b2 = self.anchors[tracks], last.bearings[np.searchsorted(last.tracks, tracks)]
        T = np.broadcast_to(T_last, (len(tracks), 4, 4))
        distance, angle = ray_distance(b1, b2, T[:, :3, :3], lenses.between(T, b1, b2))
        good = (distance > 0.1 * MEDIAN_DISTANCE) & (distance < 20 * MEDIAN_DISTANCE) & (angle > np.deg2rad(0.3))
        eye = np.broadcast_to(np.eye(4), (int(good.sum()), 4, 4))
        return lenses.places(eye, b1[good], distance[good]), tracks[good]

    def _intermediate_frames(self) -> list[int]:
        """Positions of up to three mappable frames between the two views."""
        inner = [i for i in range(1, len(self.history) - 1) if self.history[i].mappable]
        if not inner:
            return []
        pick = np.unique(np.linspace(0, len(inner) - 1, min(3, len(inner))).round().astype(int))
        return [inner[i] for i in pick]

    def _intermediate_poses(
        self, frames: list[int], points: Array, tracks: NDArray[np.int64], T_last: Array
    ) -> list[Array]:
        point_of_track = np.full(len(self.anchors), -1)
        point_of_track[tracks] = np.arange(len(tracks))
        return [
            solve_initial_frame(self.history[g], points, point_of_track, T_last, self.face_set, len(self.history), g)
            for g in frames
        ]

    def _make_map(
        self,
        points: Array,
        tracks: NDArray[np.int64],
        good: NDArray[np.bool_],
        T_cw: Array,
        chosen: list[int],
        scale: float,
    ) -> PointMap:
        m = PointMap(self.templates.shape[1], self.face_set.lenses)
        # All other corners are tracked on as candidates at the median distance.
        position = self.anchors * MEDIAN_DISTANCE
        position[tracks[good]] = points[good]
        state = np.full(len(self.anchors), CANDIDATE)
        state[tracks[good]] = ACTIVE
        m.add(
            len(self.anchors),
            position=position,
            state=state,
            anchor_bearing=self.anchors,
            bearing=self.current,
            last_seen=self.history[-1].index,
            template=self.templates,
            descriptor=describe(self.templates),
        )
        m.state[(m.state == CANDIDATE) & ~self.alive] = DEAD
        for number, (g, T) in enumerate(zip(chosen, T_cw)):
            T = T.copy()
            T[:3, 3] *= scale
            initial = self.history[g]
            m.keyframes.append(Keyframe(number, initial.index, T, initial.tracks.copy(), initial.bearings.copy()))
        return m


def solve_initial_frame(
    initial: InitialFrame,
    points: Array,
    point_of_track: NDArray[np.int64],
    T_last: Array,
    face_set: FaceSet,
    count: int,
    position: int,
) -> Array:
    """Pose (4, 4) of an earlier frame from points (P, 3). ``point_of_track`` has each track's point, or -1."""
    T = make_pose(initial.rotation, T_last[:3, 3] * position / max(1, count - 1))
    use = point_of_track[initial.tracks] >= 0
    X, b = points[point_of_track[initial.tracks[use]]], initial.bearings[use]
    focal, origins = face_set.focal, face_set.lenses.origins(b)
    T = solve_pose(T, X, b, focal, 1.0, 20, origins)
    near = pose_errors(T, X, b, focal, origins) < 3.0
    kept = None if origins is None else origins[near]
    return solve_pose(T, X[near], b[near], focal, 1.0, 10, kept) if int(near.sum()) >= 6 else T


def _angle_between(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def _robust_rotation(a: Array, b: Array) -> Array:
    """Rotation that takes unit vectors a (N, 3) to b (N, 3): Kabsch, reweighted by the residuals."""
    w = np.ones(len(a))
    R = np.eye(3)
    for _ in range(4):
        U, _, Vt = np.linalg.svd((b * w[:, None]).T @ a)
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        r = np.linalg.norm(a @ R.T - b, axis=1)
        w = 1.0 / np.maximum(r, 0.3 * np.median(r) + 1e-6)
    return np.asarray(R)

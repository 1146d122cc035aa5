"""``sparse``: feature SLAM on bearing vectors for any central camera.

The camera model is used once, to cut tangent faces out of each image (``faces``). Corners are followed by aligning
stored tangent-plane templates (``patches``); two views start the map (``initialise``); every frame's pose is solved
against it (``tracking``); keyframes grow it and local bundle adjustment refines it (``mapping``).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise
from panobench.methods.base import MethodContext, OnlineMethod
from panobench.methods.sparse.adjust import pose_errors, solve_pose
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.faces import FaceRig, build_rig
from panobench.methods.sparse.initialise import Glimpse, Initialiser, solve_glimpse
from panobench.methods.sparse.mapping import (
    add_candidates,
    adjust_window,
    drop_lost_candidates,
    local_window,
    promote_candidates,
    reanchor,
)
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, Keyframe, PointMap
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame, update_candidates
from panobench.types import Estimate, Frame, Trajectory

Array = NDArray[np.float64]


class SparseMethod(OnlineMethod):
    """See the module's text. Poses are in the first frame's axes, scaled to a median distance of 2."""

    config: SparseConfig
    rig: FaceRig

    def __init__(self, config: SparseConfig | None = None) -> None:
        super().__init__(config or SparseConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.context = context
        self.rig = build_rig(camera, self.config.face_pixels, self.config.levels)
        self.rng = np.random.default_rng(context.seed)
        self.pool = ThreadPoolExecutor(2)
        self.initialiser = Initialiser(self.rig, self.config, self.rng, self.pool)
        self.map: PointMap | None = None
        self.records: list[FrameRecord] = []
        self.numbers: dict[int, dict[str, float]] = {}
        self.T_cw = np.eye(4)
        self.velocity = np.eye(4)
        self.last_index = -1
        self.lost = 0

    def track(self, frame: Frame) -> Array | None:
        pyramid = self.rig.pyramid(frame.image, self.config.levels)
        if self.map is None:
            return self._initialise(pyramid, frame)
        return self._track(pyramid, frame)

    # -- before there is a map ---------------------------------------------------------------------------------

    def _initialise(self, pyramid: Pyramid, frame: Frame) -> Array | None:
        built = self.initialiser.add(pyramid, frame.index, frame.time, frame.mappable)
        if built is None:
            return None
        self.map, glimpses = built
        m = self.map
        focal = self.rig.focal
        everything = [k.number for k in m.keyframes]
        adjust_window(m, self.config, focal, everything, 10)
        newest = m.keyframes[-1]
        where = np.where(m.state == ACTIVE, np.arange(m.size), -1)
        known = {k.frame: k for k in m.keyframes}
        for position, glimpse in enumerate(glimpses):
            key = known.get(glimpse.index)
            if key is not None:
                T = key.T_cw
            else:
                T = solve_glimpse(glimpse, m.position, where, newest.T_cw, focal, len(glimpses), position)
            self._record(glimpse, T, key or m.keyframes[0], where)
        self.context.log(
            f"frame {frame.index}: map of {int((m.state == ACTIVE).sum())} points from {len(glimpses)} frames"
        )
        promote_candidates(m, self.config, newest)
        add_candidates(m, self.rig, self.config, pyramid, newest)
        if len(self.records) >= 2:
            before = self._pose_of(self.records[-2])
            self.velocity = newest.T_cw @ invert_pose(before)
        self.T_cw, self.last_index = newest.T_cw, frame.index
        return invert_pose(self.T_cw)

    def _record(self, glimpse: Glimpse, T_cw: Array, key: Keyframe, where: NDArray[np.int64]) -> None:
        use = where[glimpse.tracks] >= 0
        self.records.append(
            FrameRecord(
                glimpse.index,
                glimpse.time,
                key.number,
                T_cw @ invert_pose(key.T_cw),
                glimpse.tracks[use],
                glimpse.bearings[use].astype(np.float32),
            )
        )

    # -- with a map --------------------------------------------------------------------------------------------

    def _track(self, pyramid: Pyramid, frame: Frame) -> Array | None:
        m = self.map
        assert m is not None
        aligner = Aligner(self.rig, self.config, m, self.pool)
        tracked = None
        for guess in (self.velocity @ self.T_cw, self.T_cw):
            tracked = track_frame(aligner, pyramid, renormalise(guess), frame.index, self.config.min_inliers)
            if tracked is not None:
                break
        if tracked is None:
            self.lost += 1
            self.velocity = np.eye(4)
            return None
        self.lost = 0
        update_candidates(m, tracked)
        self.velocity = renormalise(tracked.T_cw @ invert_pose(self.T_cw))
        self.T_cw = tracked.T_cw
        self.numbers[frame.index] = {"points": float(len(tracked.points)), "error_px": tracked.error_px}
        reference = m.keyframes[-1]
        if frame.mappable and self._wants_keyframe(frame, tracked):
            reference = self._add_keyframe(pyramid, frame, tracked)
        self.records.append(
            FrameRecord(
                frame.index,
                frame.time,
                reference.number,
                self.T_cw @ invert_pose(reference.T_cw),
                tracked.points,
                tracked.bearings.astype(np.float32),
            )
        )
        return invert_pose(self.T_cw)

    def _wants_keyframe(self, frame: Frame, tracked: Tracked) -> bool:
        m, config = self.map, self.config
        assert m is not None
        last = m.keyframes[-1]
        centre = -tracked.T_cw[:3, :3].T @ tracked.T_cw[:3, 3]
        moved = float(np.linalg.norm(centre + last.T_cw[:3, :3].T @ last.T_cw[:3, 3]))
        depth = float(np.median(np.linalg.norm(m.position[tracked.points] - centre, axis=1)))
        before = int((m.state[last.points] == ACTIVE).sum())
        thin = len(tracked.points) + len(tracked.candidates) < config.keyframe_ratio * len(last.points)
        few = len(tracked.points) < config.keyframe_ratio * min(before, config.features)
        late = frame.index - last.frame >= config.keyframe_gap
        return moved > config.keyframe_distance * depth or thin or few or (late and moved > 0.01 * depth)

    def _add_keyframe(self, pyramid: Pyramid, frame: Frame, tracked: Tracked) -> Keyframe:
        m, config, focal = self.map, self.config, self.rig.focal
        assert m is not None
        key = Keyframe(
            len(m.keyframes),
            frame.index,
            tracked.T_cw,
            np.concatenate([tracked.points, tracked.candidates]),
            np.concatenate([tracked.bearings, tracked.candidate_bearings]),
        )
        m.keyframes.append(key)
        promote_candidates(m, config, key)
        drop_lost_candidates(m)
        adjust_window(m, config, focal, local_window(m, key.number, config.window), 6)
        self.T_cw = key.T_cw
        reanchor(m, self.rig, pyramid, key)
        add_candidates(m, self.rig, config, pyramid, key)
        return key

    # -- the end -----------------------------------------------------------------------------------------------

    def _pose_of(self, record: FrameRecord) -> Array:
        assert self.map is not None
        return renormalise(record.T_ck @ self.map.keyframes[record.keyframe].T_cw)

    def finish(self) -> Estimate:
        self.pool.shutdown()
        m = self.map
        if m is None:
            empty = Trajectory(np.empty(0), np.empty((0, 4, 4)))
            return Estimate(empty, extra={"initialised": False})
        extra: dict[str, Any] = {"initialised": True}
        if self.config.final_ba > 0:
            everything = [k.number for k in m.keyframes]
            extra["reprojection_px"] = adjust_window(m, self.config, self.rig.focal, everything, self.config.final_ba)
        poses = []
        for record in self.records:
            T = self._pose_of(record)
            poses.append(invert_pose(self._refit(record, T) if self.config.refit else T))
        extra["points"] = int((m.state == ACTIVE).sum())
        return Estimate(
            Trajectory(np.array([r.time for r in self.records]), np.stack(poses)),
            keyframes=[k.frame for k in m.keyframes],
            frames=self.numbers,
            extra=extra,
        )

    def _refit(self, record: FrameRecord, T: Array) -> Array:
        """The pose again, from the frame's own measurements and the points as they are now."""
        m = self.map
        assert m is not None
        alive = m.state[record.points] == ACTIVE
        X, b = m.position[record.points[alive]], record.bearings[alive].astype(np.float64)
        near = pose_errors(T, X, b, self.rig.focal) < 4.0
        if int(near.sum()) < self.config.min_inliers:
            return T
        return solve_pose(T, X[near], b[near], self.rig.focal, self.config.huber_px, 10)

"""``sparse``: feature SLAM on bearing vectors for any central camera.

The camera model is used only to resample each image to perspective faces (``faces``). Corners are tracked by aligning
stored tangent-plane templates (``patches``). Two views initialise the map (``initialise``), and every frame's pose is
solved against it (``tracking``). Keyframes add points, and local bundle adjustment refines them (``mapping``). A lost
camera is relocalised by descriptors (``relocalise``), and loops are closed (``loop``). At the end every pose is solved
once more (``refine``).
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, make_pose, renormalise, so3_log
from panobench.inertial.fusion import Unit
from panobench.inertial.prediction import looks_elsewhere
from panobench.inertial.rotation_prior import RotationPrior
from panobench.inertial.stage import InertialStage, MetricPoses
from panobench.methods.base import MethodContext, OnlineMethod
from panobench.methods.ground import height_above_ground
from panobench.methods.lens_scale import is_metric, scale_numbers
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.faces import FaceSet, build_faces, levels_for
from panobench.methods.sparse.initialise import Initialiser, solve_initial_frame
from panobench.methods.sparse.loop import close_loop, detect_loop
from panobench.methods.sparse.mapping import (
    add_candidates,
    adjust_window,
    drop_lost_candidates,
    local_window,
    promote_candidates,
    renew_templates,
)
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, Keyframe, PointMap
from panobench.methods.sparse.refine import adjust_exactly, correct_shutter, refined_poses
from panobench.methods.sparse.relocalise import find_again
from panobench.methods.sparse.rig_faces import RigFaces, build_rig_faces
from panobench.methods.sparse.rotation import RotationFinder
from panobench.methods.sparse.scale import adjust_scale, is_due, scale_sigma
from panobench.methods.sparse.session import Session
from panobench.methods.sparse.stitched import undo_stitching
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame, update_candidates
from panobench.photometric.overlap import ViewWidth
from panobench.types import Estimate, Frame, Trajectory

Array = NDArray[np.float64]

#: A map with fewer keyframes is given up sooner when tracking fails, because it was probably wrong.
YOUNG_MAP = 6
#: Least number of keyframes between two loop closures.
LOOP_INTERVAL = 8
#: Face sizes are multiples of 2^(MAX_LEVELS - 1).
MAX_LEVELS = 5


class SparseMethod(OnlineMethod):
    """See the module's docstring. Poses are in the first frame's axes; the first map has a median distance of 2."""

    config: SparseConfig
    face_set: FaceSet
    rig_faces: RigFaces | None

    def __init__(self, config: SparseConfig | None = None) -> None:
        super().__init__(config or SparseConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.context, self.camera = context, camera
        levels = self.config.levels or MAX_LEVELS
        rig = context.rig if self.config.rig else None
        # Metres are told by small motions: of the lenses about each other, and of strides.
        self.exact = rig is not None or context.imu is not None
        self.rig_faces = None if rig is None else build_rig_faces(rig, self.config.face_pixels, levels)
        self.face_set = self.rig_faces or build_faces(camera, self.config.face_pixels, levels, fine=self.exact)
        if self.exact and self.face_set.source_scale > 1.0:  # a measurement is as good as the image's pixels are fine
            self.config = replace(self.config, huber_px=self.config.huber_px * self.face_set.source_scale)
        self.levels = self.config.levels or levels_for(self.face_set.focal)
        self.narrow = ViewWidth.of(camera) is ViewWidth.NARROW
        self.finder = RotationFinder(self.face_set, self.levels)
        self.rng = np.random.default_rng(context.seed)
        self.pool = ThreadPoolExecutor(2)
        self.inertial = InertialStage(context.imu, context.log, context.warn, self._pose_of)
        self.initialiser = Initialiser(self.face_set, self.config, self.rng, self.pool, self.exact)
        self.session: Session | None = None
        self.previous: list[Session] = []
        self.numbers: dict[int, dict[str, float]] = {}

    def track(self, frame: Frame) -> Array | None:
        self.inertial.saw(frame.index, frame.time)
        if self.rig_faces is not None:
            pyramid = self.rig_faces.pyramids(frame.lenses, self.levels)
        else:
            pyramid = self.face_set.pyramid(frame.image, self.levels)
        self.finder.push(pyramid)
        if self.session is not None:
            return self._track(self.session, pyramid, frame)
        T_wc = self._resume(pyramid, frame)
        return self._initialise(pyramid, frame) if T_wc is None else T_wc

    # -- before there is a map ---------------------------------------------------------------------------------

    def _initialise(self, pyramid: Pyramid, frame: Frame) -> Array | None:
        built = self.initialiser.add(pyramid, frame.index, frame.time, frame.mappable, self.finder.rotation())
        if built is None:
            return None
        m, history = built
        session = Session(m)
        focal = self.face_set.focal
        adjust_window(m, self.config, focal, [k.number for k in m.keyframes], 10)
        newest = m.keyframes[-1]
        point_of_track = np.where(m.state == ACTIVE, np.arange(m.size), -1)
        known = {k.frame: k for k in m.keyframes}
        for position, initial in enumerate(history):
            key = known.get(initial.index)
            if key is not None:
                T = key.T_cw
            else:
                T = solve_initial_frame(
                    initial, m.position, point_of_track, newest.T_cw, self.face_set, len(history), position
                )
            session.add_initial(initial, T, key or m.keyframes[0], point_of_track)
        self.context.log(
            f"frame {frame.index}: map of {int((m.state == ACTIVE).sum())} points from {len(history)} frames"
        )
        promote_candidates(m, self.config, newest)
        add_candidates(m, self.face_set, self.config, pyramid, newest)
        if len(session.records) >= 2:
            session.velocity = newest.T_cw @ invert_pose(session.pose_of(session.records[-2]))
        session.T_cw = newest.T_cw
        self.session = session
        for record in session.records:
            self.inertial.tracked(record.index, record.time)
        return invert_pose(session.T_cw)

    def _resume(self, pyramid: Pyramid, frame: Frame) -> Array | None:
        """While a new map is being initialised: relocalise in the previous one."""
        if not self.previous or len(self.previous[-1].map.keyframes) < YOUNG_MAP:
            return None
        session, heading = self.previous[-1], self.inertial.heading(frame.time)
        tracked = find_again(self._aligner(session), pyramid, frame.index, self.rng, heading)
        if tracked is None:
            return None
        self.context.log(f"frame {frame.index}: relocalised in the previous map")
        self.previous.pop()
        self.session = session
        return self._accept(session, pyramid, frame, tracked, recovered=True)

    # -- with a map --------------------------------------------------------------------------------------------

    def _aligner(self, session: Session) -> Aligner:
        return Aligner(self.face_set, self.config, session.map, self.pool, self.exact)

    def _track(self, session: Session, pyramid: Pyramid, frame: Frame) -> Array | None:
        aligner = self._aligner(session)
        expected = self.inertial.expect(frame.time)
        heading = self.inertial.heading(frame.time) if expected is None else expected
        for guess, prior in self._guesses(session, expected, frame.time):
            few = self.config.min_inliers
            tracked = track_frame(aligner, pyramid, renormalise(guess), frame.index, few, prior=prior)
            if tracked is not None and not looks_elsewhere(invert_pose(tracked.T_cw), heading):
                return self._accept(session, pyramid, frame, tracked, recovered=session.lost > 0)
        tracked = find_again(aligner, pyramid, frame.index, self.rng, heading)
        if tracked is not None:
            session.relocalised += 1
            return self._accept(session, pyramid, frame, tracked, recovered=True)
        if session.lost == 0:
            self.context.log(f"frame {frame.index}: lost")
        session.lost += 1
        max_lost = (
            self.config.restart_after if len(session.map.keyframes) >= YOUNG_MAP else self.config.restart_after // 4
        )
        if session.lost >= max_lost and expected is None:  # the IMU may still know where the camera is
            self.previous.append(session)
            self.session = None
            self.initialiser.reset()
        return None

    def _guesses(
        self, session: Session, expected: Array | None, time_s: float
    ) -> Iterator[tuple[Array, RotationPrior | None]]:
        """Predicted poses T_cw, the most likely first, and what holds their rotation. The costly ones are computed only
        when they are needed.

        expected: T_wc by the IMU. Its rotation is a prior in a narrow view, which can trade a turn for a step aside; a
        wide one tells the two apart better than a gyroscope. Should no pose be found with it, none is held by it.
        """
        if expected is not None:
            held = self.inertial.rotation_prior(expected, time_s).inverse if self.narrow else None
            yield invert_pose(expected), held
        if session.lost == 0:
            yield session.velocity @ session.T_cw, None
            yield make_pose(self.finder.rotation(), np.zeros(3)) @ session.T_cw, None
        else:
            yield session.T_cw, None

    def _accept(
        self, session: Session, pyramid: Pyramid, frame: Frame, tracked: Tracked, recovered: bool = False
    ) -> Array:
        m = session.map
        if session.lost:
            self.context.log(f"frame {frame.index}: found again after {session.lost} frames")
        session.lost = 0
        update_candidates(m, tracked)
        session.velocity = np.eye(4) if recovered else renormalise(tracked.T_cw @ invert_pose(session.T_cw))
        session.T_cw = tracked.T_cw
        self.numbers[frame.index] = {"points": float(len(tracked.points)), "error_px": tracked.error_px}
        distances = np.linalg.norm(m.position[tracked.points] @ tracked.T_cw[:3, :3].T + tracked.T_cw[:3, 3], axis=1)
        height = height_above_ground(tracked.bearings, distances)
        if np.isfinite(height):
            self.numbers[frame.index]["height"] = height
        reference = m.keyframes[-1]
        if frame.mappable and self._wants_keyframe(m, frame, tracked):
            reference = self._add_keyframe(session, pyramid, frame, tracked)
        session.records.append(
            FrameRecord(
                frame.index,
                frame.time,
                reference.number,
                session.T_cw @ invert_pose(reference.T_cw),
                tracked.points,
                tracked.bearings.astype(np.float32),
            )
        )
        self.inertial.tracked(frame.index, frame.time)
        return invert_pose(session.T_cw)

    def _pose_of(self, index: int) -> Array | None:
        """T_wc of a frame of the present map, or of the one that was lost while another is begun."""
        session = self.session or (self.previous[-1] if self.previous else None)
        return None if session is None else session.find(index)

    def _wants_keyframe(self, m: PointMap, frame: Frame, tracked: Tracked) -> bool:
        config = self.config
        last = m.keyframes[-1]
        centre = -tracked.T_cw[:3, :3].T @ tracked.T_cw[:3, 3]
        moved = float(np.linalg.norm(centre + last.T_cw[:3, :3].T @ last.T_cw[:3, 3]))
        depth = float(np.median(np.linalg.norm(m.position[tracked.points] - centre, axis=1)))
        before = int((m.state[last.points] == ACTIVE).sum())
        thin = len(tracked.points) + len(tracked.candidates) < config.keyframe_ratio * len(last.points)
        few = len(tracked.points) < config.keyframe_ratio * min(before, config.features)
        late = frame.index - last.frame >= config.keyframe_gap
        return moved > config.keyframe_distance * depth or thin or few or (late and moved > 0.01 * depth)

    def _add_keyframe(self, session: Session, pyramid: Pyramid, frame: Frame, tracked: Tracked) -> Keyframe:
        m, config, focal = session.map, self.config, self.face_set.focal
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
        if config.loops and key.number >= session.last_loop + LOOP_INTERVAL:
            self._close_loop(session, pyramid, key)
        if m.lenses.several and is_due(len(m.keyframes)):
            self._adjust_scale(session)
        session.T_cw = key.T_cw
        renew_templates(m, self.face_set, pyramid, key)
        add_candidates(m, self.face_set, config, pyramid, key)
        return key

    def _close_loop(self, session: Session, pyramid: Pyramid, key: Keyframe) -> None:
        m = session.map
        known = m.lenses.several or self.inertial.knows_scale
        loop = detect_loop(self._aligner(session), pyramid, key, self.rng, keep_scale=known)
        if loop is None:
            return
        turned = float(np.degrees(np.linalg.norm(so3_log(loop.correction.R))))
        if self.inertial.refuses_turn(turned):
            self.context.log(f"frame {key.frame}: a loop that turns the camera by {turned:.1f} degrees is refused")
            return
        scales = close_loop(m, loop, session.records, self.face_set.focal)
        adjust_window(m, self.config, self.face_set.focal, [k.number for k in m.keyframes], 10, settled=False)
        session.velocity[:3, 3] *= scales[key.number]
        session.last_loop = key.number
        session.loops += 1
        old = m.keyframes[loop.old].frame
        self.context.log(f"frame {key.frame}: loop with frame {old}, scale drift {loop.correction.scale:.3f}")

    def _adjust_scale(self, session: Session) -> None:
        growth = adjust_scale(session.map, self.config, self.face_set.focal)
        session.grew(growth)
        self.context.log(
            f"{len(session.map.keyframes)} keyframes: the lenses' distance changes the scale by {growth:.3f}"
        )

    # -- the end -----------------------------------------------------------------------------------------------

    def finish(self) -> Estimate:
        self.pool.shutdown()
        sessions = [*self.previous, *([self.session] if self.session is not None else [])]
        if not sessions:
            empty = Trajectory(np.empty(0), np.empty((0, 4, 4)))
            return Estimate(empty, extra={"initialised": False})
        session = max(sessions, key=lambda s: len(s.records))
        m, focal = session.map, self.face_set.focal
        extra: dict[str, Any] = {
            "initialised": True,
            "maps": len(sessions),
            "loops": session.loops,
            "relocalised": session.relocalised,
            "pixels_per_radian": round(focal, 1),
        }
        if self.config.final_ba > 0:
            everything = [k.number for k in m.keyframes]
            if m.lenses.several:
                self._adjust_scale(session)
            extra["reprojection_px"] = adjust_window(m, self.config, focal, everything, self.config.final_ba)
        if self.config.stitch_mm and self.camera.kind == "erp" and not m.lenses.several:
            session.grew(undo_stitching(m, session.records, self.config, focal, extra))
        rig = None if self.rig_faces is None else self.context.rig
        readout_s = correct_shutter(session, self.camera, self.config, focal, self.context.log, rig)
        extra["readout_ms"] = round(1e3 * readout_s, 2)
        if self.exact and self.config.final_ba > 0:
            adjust_exactly(m, self.config, focal)
        by_lenses = self.face_set.lenses.several and self._judge_scale(m, extra)
        sigma = extra["scale_sigma_percent"] if by_lenses else None
        poses = refined_poses(session, self.config, focal, exact=self.exact)
        extra["points"] = int((m.state == ACTIVE).sum())
        metric = self._metric(session, poses, sessions, None if sigma is None else Unit(1.0, 0.01 * sigma))
        if self.inertial.enabled:
            extra["inertial"] = self.inertial.numbers
        if metric is not None:
            poses = metric.poses
        times = {r.index: r.time for s in sessions for r in s.records} | self.inertial.times
        indices = sorted(poses)
        return Estimate(
            Trajectory(np.array([times[i] for i in indices]), np.stack([poses[i] for i in indices])),
            keyframes=[k.frame for k in m.keyframes],
            metric=metric is not None or by_lenses,
            gravity_aligned=metric is not None,
            frames=self.numbers,
            extra=extra,
        )

    def _judge_scale(self, m: PointMap, extra: dict[str, Any]) -> bool:
        """Say in ``extra`` how certain the scale is; whether that is enough to call it metric."""
        sigma = scale_sigma(m, self.config, self.face_set.focal)
        extra.update(scale_numbers(len(m.lenses.centres), sigma))
        metric = is_metric(sigma, self.context.warn)
        if metric:
            self.context.log(f"the scale is metric, give or take {100 * sigma:.2g}% (one standard deviation)")
        return metric

    def _metric(
        self, session: Session, poses: dict[int, Array], sessions: list[Session], unit: Unit | None
    ) -> MetricPoses | None:
        """The trajectory in metres, of all maps, if there is an IMU; frames of several maps count for the longest.

        unit: what a rig's lenses tell of the map's.
        """
        if not self.inertial.enabled:
            return None
        maps = [poses]
        for other in sorted((s for s in sessions if s is not session), key=lambda s: -len(s.records)):
            known = {index for found in maps for index in found}
            refined = refined_poses(other, self.config, self.face_set.focal, exact=self.exact)
            maps.append({index: T for index, T in refined.items() if index not in known})
        return self.inertial.finish(maps, unit)

    def known_poses(self) -> dict[int, Array]:
        """Those of the map with most frames, which ``finish`` answers with."""
        sessions = [*self.previous, *([self.session] if self.session is not None else [])]
        session = max(sessions, key=lambda s: len(s.records), default=None)
        return {} if session is None else {r.index: invert_pose(session.pose_of(r)) for r in session.records}

"""PanoGS-SLAM: monocular panoramic Gaussian splatting SLAM as an online method.

Mao et al., "PanoGS-SLAM: Panoramic 3D Gaussian Splatting SLAM". What differs from the paper is in docs/panogs.md.
"""

from __future__ import annotations

import time
from dataclasses import replace
from enum import Enum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, make_pose
from panobench.inertial.fusion import Unit
from panobench.inertial.rotation_prior import RotationPrior
from panobench.inertial.stage import InertialStage, MetricPoses
from panobench.maps.saved import SavedMap
from panobench.masks.frame_masks import FrameMasks
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.config import PanogsConfig, StitchOptions
from panobench.methods.panogs.factor_graph.factors import FactorGraph
from panobench.methods.panogs.factor_graph.place_recognition import Places
from panobench.methods.panogs.factor_graph.revisits import RevisitFactors
from panobench.methods.panogs.first_map.exposure_chain import ExposureChain
from panobench.methods.panogs.first_map.start import FirstMap, Start
from panobench.methods.panogs.first_map.view import well_seen
from panobench.methods.panogs.fixed_lag.stage import FixedLag
from panobench.methods.panogs.jobs import BackgroundJobs
from panobench.methods.panogs.mapping.ghosts import remove_ghosts
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.rectification.late_rates import LateRates, renew_image
from panobench.methods.panogs.rectification.rectify import Rectifier
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam
from panobench.methods.panogs.rigs.frames import rig_frames
from panobench.methods.panogs.several_maps.continuation import add_places, continue_map, saved_map
from panobench.methods.panogs.tracking.agreement import agreement
from panobench.methods.panogs.tracking.exposure import ExposureMatcher, is_blank
from panobench.methods.panogs.tracking.relocalise import Relocaliser
from panobench.methods.panogs.tracking.tracker import Tracked, Tracker
from panobench.methods.panogs.trajectory import AnchoredTrajectory, Correction
from panobench.methods.splatting.views import View
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32
from panobench.splat.backend import device_for
from panobench.splat.render import Renderer
from panobench.splat.rig_render import renderer_for
from panobench.splat.view import Projection
from panobench.types import DepthEstimate, Estimate, Frame, Trajectory

Pose = NDArray[np.float64]


class Phase(Enum):
    """What the method is doing."""

    WAITING = "waiting for parallax"
    TRACKING = "tracking"
    LOST = "lost"
    FINISHING = "finishing"


class PanogsMethod(OnlineMethod):
    """One frame is: track, judge, record, map, next job. See ``_process``."""

    config: PanogsConfig
    uses_device = True

    def __init__(self, config: PanogsConfig | None = None) -> None:
        super().__init__(config or PanogsConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        c, width = self.config, ViewWidth.of(camera)
        self.camera, self.context, self.phase = camera, context, Phase.WAITING
        self.rig = rig_frames(camera, context, c)
        camera = self.rig.camera if self.rig else camera
        self.places = Places(camera, gaps=context.rig is not None or context.imu is not None)
        self.device = None if self.rig else device_for(context.device, camera, self._projection)
        if context.device is not None and self.device is None:
            context.warn("the GPU draws panoramas of one centre on the sphere alone: this run uses the CPU")
        renderer = renderer_for(camera, self._projection, c.rendering.low_pass, device=self.device)
        tracking_renderer = renderer_for(camera, self._projection, c.rendering.low_pass, stop=1e-3, device=self.device)

        self.trajectory = AnchoredTrajectory()
        # A saved map has a frame of its own, in which the poses stay.
        imu = context.imu if context.saved_map is None else None
        self.inertial = InertialStage(imu, context.log, context.warn, self.trajectory.get)
        self.in_metres = False
        self.tracker = Tracker(camera, tracking_renderer, c)
        self.relocaliser = Relocaliser(self.tracker, self.places, c.relocalisation)
        self.mapper = Mapper(camera, renderer, c, self.trajectory, context.seed)
        self.tracker.transients = self.mapper.transients
        self.tracker.occluded = self.mapper.occluded
        rows = self.rig.rolling_shutter(c.rolling_shutter) if self.rig else c.rolling_shutter
        stitch = StitchOptions() if self.rig else c.stitch  # the panorama of a rig is not stitched
        self.shutter, self.seam = RollingShutter(camera, rows), Seam(camera, stitch)
        self.rectifier = Rectifier(camera, self.shutter, self.seam)
        self.late_rates = LateRates(self.rectifier, self.trajectory)
        self.exposure = ExposureMatcher(self.mapper.weights, width, c.exposure)
        self.lag = FixedLag(camera, c.fixed_lag, self.mapper, self.trajectory)
        buffer = self.lag.buffer
        revisits = RevisitFactors(buffer.sweep_scale, c.revisits) if c.revisits.enabled else None
        self.graph = FactorGraph(buffer.fine_scale, width, c.factors, revisits, self.rig.scale if self.rig else None)
        self.jobs = BackgroundJobs(self.mapper, self.trajectory, self.graph, self.lag, width)
        self.trajectory.followers = [self.mapper, self.tracker, self.relocaliser]

        self.first_frames = Start(camera, context, c.start, ExposureChain(camera, c.exposure), self.rectifier)
        self.first_depth: DepthEstimate | None = None
        self.before_first: list[Frame] = []  # frames before the one whose depth the map starts from
        self.numbers: dict[int, dict[str, float]] = {}
        self.moving = FrameMasks()
        if context.saved_map is not None:
            self._go_on(context.saved_map)

    @property
    def _projection(self) -> Projection:
        chosen = self.config.rendering.projection
        return "sphere" if chosen == "auto" else chosen

    # -- one frame -----------------------------------------------------------------------------------------------------

    def track(self, frame: Frame) -> Pose | None:
        self.inertial.saw(frame.index, frame.time)
        frame = self.rig.frame(frame) if self.rig else frame
        if is_blank(frame.image, self.tracker.valid):
            self._skip(frame)
            return self.trajectory.get(frame.index)
        self.mapper.optimiser.sharpness.look(frame.index, frame.image)
        if self.phase is Phase.WAITING:
            self._begin(self.first_frames.add(frame))
        else:
            self._process(frame)
        return self.trajectory.get(frame.index)

    def _process(self, frame: Frame) -> None:
        """Track, judge, record, map, next job."""
        began = time.perf_counter()
        gaussians = self.mapper.map.gaussians
        expected = self.inertial.expect(frame.time, lost=self.phase is Phase.LOST)
        # A narrow view can trade a turn for a step aside; a wide one tells the two apart better than a gyroscope.
        narrow = self.mapper.width is ViewWidth.NARROW
        held = self.inertial.rotation_prior(expected, frame.time) if narrow and expected is not None else None
        frame, tracked = self._track(frame, expected, held)
        trusted = self.relocaliser.judge(tracked, gaussians, self.trajectory.keyframes, expected)
        if trusted is None:
            self._enter(Phase.LOST)
            self.shutter.forget()
            self.tracker.hidden = None
            self._note(frame, lost=1.0, tracking_s=time.perf_counter() - began)
            return
        self._enter(Phase.TRACKING)
        self.relocaliser.strict = False
        frame = self._at_map_exposure(frame, trusted)
        scene_depth = self.mapper.local_depth(trusted.render)
        self._record(frame, trusted, scene_depth)
        tracking_s = time.perf_counter() - began
        self._note(frame, tracking_s=tracking_s, loss=trusted.cost, iterations=trusted.iterations)
        self._note(frame, gaussians=len(gaussians), height=self.mapper.height(trusted.render))
        if frame.mappable:
            self._map(frame, trusted)
        self.jobs.run_next(scene_depth)
        self.mapper.optimiser.work_for_a_frame()
        self.tracker.reset(self.trajectory[frame.index], self.tracker.velocity)
        self.shutter.record(frame.time, self.trajectory[frame.index])
        self.inertial.tracked(frame.index, frame.time)
        self._note(frame, mapping_s=time.perf_counter() - began - tracking_s)

    def _track(self, frame: Frame, expected: Pose | None, held: RotationPrior | None) -> tuple[Frame, Tracked]:
        """Align the frame to the map; the frame as a global shutter with one centre would have seen it.

        expected (4, 4): by an IMU, which is where the alignment begins. held: what it says of the rotation, if
        the alignment is to be held by it.
        """
        gaussians, given, rate = self.mapper.map.gaussians, frame, self.shutter.predicted_rate(frame.index)
        if self.shutter.enabled:
            frame = replace(frame, image=self.rectifier.turned(given.image, rate))
        if expected is not None:
            if self.relocaliser.lost_for:  # the last render may be of far away
                self.tracker.restart(expected)
            else:
                self.tracker.expect(expected)
        before = self.tracker.T_last
        tracked = self.tracker.track(self.exposure.before(frame.image), gaussians, frame.mask, held)
        if self.rectifier.enabled and before is not None:
            measured, velocity = self.shutter.measured(frame.index, frame.time, tracked.T_wc)
            travels = self.shutter.travels(velocity, self.mapper.local_depth(tracked.render))
            if travels or self.shutter.differ(measured, rate) or self.seam.lenses is not None:
                depth_map = tracked.render.expected_depth(0.5)
                image = self.rectifier.rectified(given.image, measured, velocity, depth_map)
                self.late_rates.add(given.index, given.time, given.image, depth_map)
                frame = replace(given, image=image, mask=self.seam.visible(depth_map, given.mask))
                self.tracker.reset(before, invert_pose(before) @ tracked.T_wc)
                tracked = self.tracker.track(self.exposure.before(frame.image), gaussians, frame.mask, held)
        return frame, tracked

    def _at_map_exposure(self, frame: Frame, tracked: Tracked) -> Frame:
        """The frame with its image at the map's exposure, judged by its own render; the pyramid is of this image."""
        image = self.exposure.after(frame.image, tracked.render)
        if image is self.tracker.image:
            return frame
        self.tracker.pyramid = self.tracker.frame_pyramid(image, frame.mask)
        self.late_rates.forget()
        return replace(frame, image=image)

    def _record(self, frame: Frame, tracked: Tracked, scene_depth: float) -> None:
        """Remember the pose, and the image where it moved, for the jobs behind the tracker."""
        self.trajectory.add(frame.index, frame.time, tracked.T_wc, self.mapper.window[0])
        buffered = self.lag.buffer.add(frame, self.tracker.pyramid, tracked.T_wc[:3, 3], scene_depth)
        if buffered:
            self.graph.add(frame.index, buffered.fine)
        if self.shutter.enabled:
            renew_image(self.late_rates, self.tracker, self.mapper, self.lag.buffer, self.graph)
        self.lag.votes.add(frame)
        moved = partial(self.lag.votes.moved, tracked.T_wc, tracked.render, frame.image)
        self.tracker.hidden = hidden = self.mapper.transients.look(frame.image, tracked.render, moved, frame.mask)
        if hidden is not None:
            self._note(frame, contradicts=self.mapper.weights[hidden].sum())
            if hidden.any():
                self.moving.put(frame.index, ~hidden)

    def _map(self, frame: Frame, tracked: Tracked) -> None:
        """Make the frame a keyframe if it should be one; else the map is trained on it like on others."""
        is_keyframe, new_share = self.mapper.add_frame(frame, tracked)
        self._note(frame, new_share=new_share, keyframe=is_keyframe)
        if is_keyframe:
            self.places.add(self.places.thumbnail(self.tracker.pyramid[-1]))
            self.lag.keyframe(frame, self.mapper.local_depth(tracked.render), new_share)
            self._note(frame, agreement=agreement(self.tracker.pyramid, tracked.render, self.tracker.weights))

    def _skip(self, frame: Frame) -> None:
        """No pose for this frame; the camera is expected to move on as before."""
        self._note(frame, blank=1.0)
        self.relocaliser.interrupted()
        self.tracker.coast()

    def _note(self, frame: Frame, **numbers: float) -> None:
        """Numbers of a frame for frames.csv; what is not finite is not known."""
        known = {name: float(n) for name, n in numbers.items() if np.isfinite(n)}
        self.numbers.setdefault(frame.index, {}).update(known)

    def _enter(self, phase: Phase) -> None:
        if self.phase is not Phase.FINISHING:
            self.phase = phase

    # -- the start -----------------------------------------------------------------------------------------------------

    def _begin(self, start: FirstMap | None) -> None:
        """Build the first map, if it can be, and track the frames that waited for it."""
        if start is None:
            return
        self._enter(Phase.TRACKING)
        first, self.first_depth = start.first, start.depth
        if self.rig:
            lumas = {f.index: self._fine_luma(f) for f in start.frames if f.index in start.depth.T_wc}
            lumas[first.index] = self._fine_luma(first)
            self.first_depth = self.rig.scale.start(start.depth, lumas, self.lag.buffer.fine_scale)
        view = View(first.index, first.image, np.eye(4), visible=first.mask)
        self.exposure.start(first.image)
        self.shutter.record(first.time, view.T_wc)
        seen = well_seen(self.tracker.camera, self.first_depth, start.frames)
        self.mapper.initialise(view, first.time, self.first_depth.depth, seen)
        levels = self.tracker.frame_pyramid(view.image, first.mask)
        self.graph.add(first.index, levels[self.lag.buffer.fine_scale.level])
        self.places.add(self.places.thumbnail(levels[-1]))
        self.tracker.reset(view.T_wc)
        self._note(first, keyframe=1.0)
        estimated = self.first_depth.T_wc
        self.before_first = [f for f in start.frames if f.index < first.index]
        for frame in self.before_first:  # until there is a map to track them against, the estimator's poses have to do
            if frame.index in estimated:
                self.trajectory.add(frame.index, frame.time, estimated[frame.index], view)
        for frame in start.frames:
            if frame.index > first.index:
                if frame.index in estimated:
                    self.tracker.expect(estimated[frame.index])
                self._process(frame)

    def _fine_luma(self, frame: Frame) -> F32:
        """(h, w) at the fine working size."""
        return self.tracker.frame_pyramid(frame.image, frame.mask)[self.lag.buffer.fine_scale.level]

    def _go_on(self, saved: SavedMap) -> None:
        """Start lost in a saved map: the first frames are looked for in it."""
        continue_map(saved, self.camera, self.mapper, self.trajectory)
        keyframes = self.trajectory.keyframes
        add_places(self.places, self.mapper.map.gaussians, [v.T_wc for v in keyframes], self.mapper.renderer)
        self.tracker.reset(keyframes[-1].T_wc)
        self.relocaliser.interrupted()
        self.relocaliser.strict = True
        self._enter(Phase.LOST)

    # -- the end -------------------------------------------------------------------------------------------------------

    def finish(self) -> Estimate:
        self.phase = Phase.FINISHING
        self._begin(self.first_frames.finish())
        self.jobs.finish()
        self._track_before_first()
        if self.mapper.transients.active:
            remove_ghosts(self.mapper, self.lag.votes)
        self.mapper.optimiser.finish()
        unit = self.rig.unit(self.tracker.pixel, self.mapper.scene_depth) if self.rig else None
        metric = self._to_metres(unit)
        mine = [index for index in self.trajectory if index >= 0]  # others are a saved map's
        known = {index: (self.trajectory.time(index), self.trajectory[index]) for index in mine}
        if metric is not None:  # with frames that vision has no pose of
            known |= {i: (self.inertial.times[i], T) for i, T in metric.poses.items() if i not in known}
        indices = sorted(known)
        times = np.array([known[i][0] for i in indices])
        poses = np.array([known[i][1] for i in indices]).reshape(-1, 4, 4)
        gaussians = self.mapper.map.gaussians
        extra: dict[str, Any] = {
            "gaussians": len(gaussians),
            "projection": self._projection,
            "moving": self.mapper.transients.active,
            "readout_ms": round(1e3 * self.shutter.readout_s, 2),
        }
        extra |= {"inertial": self.inertial.numbers} if self.inertial.enabled else {}
        extra |= self.rig.numbers if self.rig else {}
        return Estimate(
            Trajectory(times, poses),
            keyframes=sorted(v.index for v in self.trajectory.keyframes if v.index >= 0),
            metric=self._metric,
            gravity_aligned=metric is not None,
            map=gaussians.on_host() if len(gaussians) else None,
            frames=self.numbers,
            depth=self.first_depth,
            extra=extra,
            moving=self.moving,
        )

    def _to_metres(self, unit: Unit | None) -> MetricPoses | None:
        """Move trajectory and map into metres, as far as an IMU and the distance of a rig's lenses tell them.

        With an IMU the world is upright, too, and its poses are returned. unit: by the lenses.
        """
        here = {index: self.trajectory[index] for index in self.trajectory}
        metric = self.inertial.finish([here], unit)
        if metric is not None:
            metres = metric.scale
            poses = {index: T for index, T in metric.poses.items() if index in here}
        elif unit is not None:
            metres = unit.metres
            poses = {index: make_pose(T[:3, :3], metres * T[:3, 3]) for index, T in here.items()}
        else:
            return None
        everywhere = dict.fromkeys((v.index for v in self.trajectory.keyframes), metres)
        self.trajectory.correct(Correction(poses, True, everywhere))
        self.in_metres = True
        if self.rig:
            self.rig.scale.lenses.units_per_metre = 1.0
        return metric

    def _track_before_first(self) -> None:
        """Track and map the frames before the first map backwards; one that is lost keeps the estimator's pose."""
        if not self.before_first:
            return
        self.lag.buffer.clear()
        self.graph.reverse()
        first = self.trajectory.keyframes[0]
        self.tracker.restart(first.T_wc)
        if first.image.size:
            self.exposure.start(first.image)
        self.relocaliser.elsewhere()
        for frame in reversed(self.before_first):
            estimated = self.trajectory.pop(frame.index)
            self._process(frame)
            if estimated is not None and frame.index not in self.trajectory:
                self.trajectory.restore(frame.index, estimated)
        self.jobs.finish()

    @property
    def _metric(self) -> bool:
        """Whether the map's unit is the metre."""
        saved = self.context.saved_map
        return saved.metric if saved else self.in_metres or bool(self.first_depth and self.first_depth.metric)

    def saved_map(self) -> SavedMap | None:
        return saved_map(self.mapper, self.camera, self.trajectory, self._metric, "panogs")

    # -- looking at it -------------------------------------------------------------------------------------------------

    def known_poses(self) -> dict[int, NDArray[np.float64]]:
        return {index: self.trajectory[index] for index in self.trajectory if index >= 0}

    def live_map(self) -> LiveMap | None:
        gaussians = self.mapper.map.gaussians
        if not len(gaussians):
            return None
        keyframes = np.array([v.T_wc for v in self.trajectory.keyframes]).reshape(-1, 4, 4)
        return LiveMap(gaussians.means, np.clip(gaussians.colours, 0.0, 1.0), keyframes)

    def render(self, camera: Camera, T_wc: Pose) -> NDArray[np.float32] | None:
        gaussians = self.mapper.map.gaussians
        if not len(gaussians):
            return None
        projection = self._projection if self._projection == camera.kind else "sphere"
        device = device_for(self.device, camera, projection)
        renderer = Renderer(camera, projection, self.config.rendering.low_pass, device=device)
        return np.ascontiguousarray(np.clip(renderer.forward(gaussians, T_wc).colour, 0.0, 1.0))

"""PanoGS-SLAM: monocular panoramic Gaussian splatting SLAM as an online method.

Mao et al., "PanoGS-SLAM: Panoramic 3D Gaussian Splatting SLAM". What differs from the paper is in docs/panogs.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import Sim3, invert_pose, renormalise
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.backend import Backend, Fit, followed, moved_by
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.dormant import Dormant, anchors_of
from panobench.methods.panogs.exposure import ExposureGuard
from panobench.methods.panogs.keyframes import is_keyframe, update_window
from panobench.methods.panogs.laps import Laps
from panobench.methods.panogs.lookback import LookBack
from panobench.methods.panogs.loops import DRIFT_MIN, LoopCloser, carry_out, move_gaussians
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.places import Places, Thumbnail
from panobench.methods.panogs.relocalise import Relocaliser
from panobench.methods.panogs.tracker import Tracked, Tracker
from panobench.methods.panogs.views import View
from panobench.splat.render import Render, Renderer
from panobench.splat.view import Projection
from panobench.types import DepthEstimate, Estimate, Frame, Trajectory

#: Standard deviation, in 8-bit levels, below which a frame shows nothing.
BLANK_LEVELS = 1.0


@dataclass
class _Record:
    """A tracked frame, tied to the keyframe it was tracked against so that it follows its refinement."""

    time: float
    anchor: View
    relative: NDArray[np.float64]

    @property
    def T_wc(self) -> NDArray[np.float64]:
        return renormalise(self.anchor.T_wc @ self.relative)


class PanogsMethod(OnlineMethod):
    """Front-end, back-end and the order in which they work."""

    config: PanogsConfig

    def __init__(self, config: PanogsConfig | None = None) -> None:
        super().__init__(config or PanogsConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.camera, self.context = camera, context
        self.renderer = Renderer(camera, self._projection(camera), self.config.low_pass)
        self.track_renderer = Renderer(camera, self._projection(camera), self.config.low_pass, stop=1e-3)
        self.mapper = Mapper(camera, self.renderer, self.config, context.seed)
        self.tracker = Tracker(camera, self.track_renderer, self.config)
        self.estimator = context.make_depth() if context.make_depth else None
        if self.estimator:
            self.estimator.start(camera, context.seed)
        self.look_back = LookBack(camera, self.config, self.mapper)
        self.recent = self.look_back.recent
        self.backend = Backend(
            self.recent.fine,
            Laps(self.recent.scale) if self.config.laps else None,
            narrow=self.look_back.view_share.narrow,
        )
        self.exposure = ExposureGuard(self.mapper.weights, not self.look_back.view_share.narrow)
        self.places = Places(camera)
        self.relocaliser = Relocaliser(self.tracker, self.places)
        self.closer = LoopCloser(self.tracker, self.places, self.relocaliser.descend)
        self.dormant = Dormant()
        self.waiting: list[Frame] = []
        self.earlier: list[Frame] = []  # than the first with depth
        self.records: dict[int, _Record] = {}
        self.numbers: dict[int, dict[str, float]] = {}
        self.depth: DepthEstimate | None = None

    def _projection(self, camera: Camera) -> Projection:
        return "sphere" if self.config.projection == "auto" else self.config.projection

    def track(self, frame: Frame) -> NDArray[np.float64] | None:
        if self._blank(frame.image):
            self._skip(frame)
            return None
        if self.depth is None:
            if not self.waiting:
                if not frame.mappable:  # the map begins with a frame it may see
                    return None
                self.exposure.start(frame.image)
            self.waiting.append(frame)
            estimate = self.estimator.add(self._exposed(frame)) if self.estimator else self._constant_depth(frame)
            if estimate is None:
                return None
            self._initialise(estimate)
        else:
            self._process(frame)
        record = self.records.get(frame.index)
        return None if record is None else record.T_wc

    def _exposed(self, frame: Frame, render: Render | None = None) -> Frame:
        """The frame at the map's exposure, by its own ``render`` if there is one; itself if it is there already."""
        if not self.config.match_exposure:
            return frame
        image = self.exposure.before(frame.image) if render is None else self.exposure.after(frame.image, render)
        return frame if image is frame.image else replace(frame, image=image)

    def _blank(self, image: NDArray[np.uint8]) -> bool:
        """Nothing to align or to map: a closed shutter, a saturated sensor, fog."""
        _, deviation = cv2.meanStdDev(image, mask=self.tracker.valid.view(np.uint8))
        return bool(deviation.max() < BLANK_LEVELS)

    def _skip(self, frame: Frame) -> None:
        """No pose for this frame; the motion before it is taken to go on."""
        self.numbers[frame.index] = {"blank": 1.0}
        self.relocaliser.interrupted()
        if self.tracker.T_last is not None:
            self.tracker.T_last = self.tracker.predict()

    def _constant_depth(self, frame: Frame) -> DepthEstimate:
        shape = frame.image.shape[:2]
        return DepthEstimate(np.full(shape, self.config.constant_depth, np.float32), frame.index)

    def _initialise(self, estimate: DepthEstimate) -> None:
        """Build the first map and track the frames that waited for it."""
        self.depth = estimate
        if estimate.message:
            self.context.log(estimate.message)
        waiting, self.waiting = self.waiting, []
        first = next(f for f in waiting if f.index == estimate.frame_index)
        view = View(first.index, first.image, np.eye(4))
        self.mapper.initialise(view, estimate.depth)
        out = self.renderer.forward(self.mapper.map, view.T_wc, count_touched=True)
        view.touched = out.touched
        self.mapper.add_keyframe(view, [view])
        levels = self.tracker.frame_pyramid(view.image)
        if self.config.adjust:
            self.backend.add(first.index, levels[self.recent.fine.level])
        self.places.add(self.places.thumbnail(levels[-1]))
        self.mapper.optimise(self.config.initial_iterations, poses=False)
        self.tracker.reset(view.T_wc)
        self.records[first.index] = _Record(first.time, view, np.eye(4))
        self.numbers[first.index] = {"keyframe": 1.0}
        self.earlier = [f for f in waiting if f.index < first.index]
        for frame in self.earlier:  # until there is a map to track them against, the estimator's poses have to do
            if frame.index in estimate.T_wc:
                self.records[frame.index] = _Record(frame.time, view, estimate.T_wc[frame.index])
        for frame in waiting:
            if frame.index > first.index:
                self._process(frame, estimate.T_wc.get(frame.index))

    def _follow_back(self) -> None:
        """Track and map the frames before the first with depth, backwards; one that is lost keeps what it has."""
        if not self.earlier:
            return
        self.recent.clear()
        self.backend.turn()
        self.tracker.reset(self.mapper.keyframes[0].T_wc)
        self.tracker.reference = None
        self.relocaliser.interrupted()
        for frame in reversed(self.earlier):
            had = self.records.pop(frame.index, None)
            self._process(frame)
            if had is not None:
                self.records.setdefault(frame.index, had)
        self._end()

    def _end(self) -> None:
        """What is left to do once no frame follows."""
        look = self.look_back
        look.settle(self._pose, self._move)
        self._adjust(at_the_end=True)
        if self.backend.unfitted:
            self._fit()
        self._settle(self.backend.close(self._pose, self.mapper.median_depth))
        look.sweep_last(self._pose, self.mapper.median_depth)
        look.settle(self._pose, self._move)
        self.mapper.work(len(self.mapper.todo))

    def _process(self, frame: Frame, hint: NDArray[np.float64] | None = None) -> None:
        began = time.perf_counter()
        if hint is not None and self.tracker.T_last is not None:
            self.tracker.velocity = invert_pose(self.tracker.T_last) @ hint
        tracked = self.tracker.track(self._exposed(frame).image, self.mapper.map)
        if self.config.relocalise:
            found = self.relocaliser.judge(tracked, self.mapper.map, self.mapper.keyframes)
            if found is None:
                self.numbers[frame.index] = {"lost": 1.0, "tracking_s": time.perf_counter() - began}
                self.dormant.wake(self.mapper)  # the camera may be anywhere
                return
            tracked = found
        depth = self.mapper.local_depth(tracked.render)
        given, frame = frame, self._exposed(frame, tracked.render)
        if frame is not given:
            self.tracker.pyramid = self.tracker.frame_pyramid(frame.image)
        moved = self.recent.add(frame, self.tracker.pyramid, tracked.T_wc[:3, 3], depth)
        if moved and self.config.adjust:
            self.backend.add(frame.index, moved.fine)
        anchor = self.mapper.window[0]
        self.records[frame.index] = _Record(frame.time, anchor, invert_pose(anchor.T_wc) @ tracked.T_wc)
        numbers = self.numbers.setdefault(frame.index, {})
        numbers |= {
            "tracking_s": time.perf_counter() - began,
            "loss": tracked.cost,
            "iterations": float(tracked.iterations),
            "gaussians": float(len(self.mapper.map)),
        }
        if frame.mappable:
            keyframe = self._map(frame, tracked)
            numbers["keyframe"] = float(keyframe)
        self._behind(depth)
        self.mapper.work(self.config.steps_per_frame or len(self.mapper.todo))
        self.tracker.reset(self._pose(frame.index), self.tracker.velocity)
        numbers["mapping_s"] = time.perf_counter() - began - numbers["tracking_s"]

    def _map(self, frame: Frame, tracked: Tracked) -> bool:
        """Keyframe decision; for a keyframe insertion, optimisation and pruning."""
        m = self.mapper
        last = m.window[0]
        seen, last_seen = tracked.render.touched, last.touched
        assert seen is not None
        assert last_seen is not None
        view = View(frame.index, frame.image, tracked.T_wc, touched=seen)
        m.note_hidden(view, tracked.render)
        unknown = m.unknown(view, tracked.render)
        new_share = float(m.weights[unknown].sum())
        distance = float(np.linalg.norm(view.position - last.position)) / m.local_depth(tracked.render)
        if not self.look_back.view_share.narrow:
            distance /= self.config.keyframe_wide
        self.numbers.setdefault(frame.index, {})["new_share"] = new_share
        if not is_keyframe(
            self.config, seen > 0, last_seen > 0, distance, abs(frame.index - last.index),
            len(m.window) >= self.config.window, new_share,
        ):  # fmt: skip
            m.remember(view)
            return False
        m.add_keyframe(view, update_window(m.window, view, self.config.window))
        if self.config.densify and new_share < self.config.split_new:
            m.split(view, tracked.render, ~unknown)
        before = len(m.map)
        thumbnail = self.places.thumbnail(self.tracker.pyramid[-1])
        self.places.add(thumbnail)
        record = self.records[frame.index]
        record.anchor, record.relative = view, np.eye(4)
        self.look_back.due = True
        m.plan(self.config.mapping_iterations)
        if not self.config.sweep or (self.look_back.view_share.narrow and new_share > self.config.guess_share):
            m.insert(view, tracked.render)
            self._draw_new(before, at_once=True)
        if self.config.loop and self.places.turns:
            self.tracker.velocity[:3, 3] *= self._close_loop(view, thumbnail)
        return True

    def _draw_new(self, before: int, *, at_once: bool) -> None:
        """Steps for what the map has more than the ``before`` Gaussians: the next frames will be tracked on it."""
        m = self.mapper
        grown = max(len(m.map) - before, 0) / m.count
        m.plan(round(self.config.mapping_iterations * min(4.0 * grown, 1.0)), first=True)
        if at_once:
            m.work(len(m.todo))

    def _behind(self, depth: float) -> None:
        """Work behind the tracker: one of its longer jobs a frame, so that no frame waits for two.

        depth: of the scene. Windows may wait for the others, but not for long. A narrow view turns away from what it
        saw: there, looks back wait for nothing.
        """
        look, before, narrow = self.look_back, len(self.mapper.map), self.look_back.view_share.narrow
        if self.backend.unfitted or self.backend.overdue():
            (self._fit if self.backend.unfitted else self._adjust)()
            if not narrow:
                return
        if look.waiting:
            look.settle(self._pose, self._move)
            self._draw_new(before, at_once=False)
        elif look.due:
            look.sweep(self._pose, depth)
        elif not self.backend.unfitted:
            self._adjust()

    def _close_loop(self, view: View, thumbnail: Thumbnail) -> float:
        """Look for a loop at the newest keyframe and close it; returns by how much the scale there changed."""
        m, closer, dormant = self.mapper, self.closer, self.dormant
        assert view.touched is not None
        closer.tie(view.touched, anchors_of(m.born), len(m.keyframes) - 1)
        dormant.update(m, view.touched)
        loop = closer.look(thumbnail, dormant.map, anchors_of(dormant.born), m)
        if loop is None:
            return 1.0
        scale = 1.0
        if loop.size >= DRIFT_MIN:
            moves = closer.spread(loop, m.keyframes)
            carry_out(moves, m, dormant, self.records)
            self.relocaliser.moved(moves[-1].apply_poses)
            scale = moves[-1].scale
        dormant.wake(m, loop.groups)
        self.tracker.reference = None
        m.plan(self.config.mapping_iterations)
        self.numbers[view.index]["loop"] = loop.size
        self.context.log(f"frame {view.index}: loop to frame {m.keyframes[loop.old].index}, drift {loop.size:.4f}")
        return scale

    def _adjust(self, *, at_the_end: bool = False) -> None:
        """The windows of bundle adjustment that are due."""
        while (k := self.backend.due(at_the_end=at_the_end)) is not None:
            render = self.renderer.forward(self.mapper.map, self._pose(self.backend.frames[k].index), sloped=True)
            self.backend.adjust(k, self._pose, render.expected_depth(0.5))
            if not at_the_end:
                break

    def _fit(self) -> None:
        """The poses that suit all windows."""
        self._settle(self.backend.fit(self._pose, self.mapper.median_depth))

    def _settle(self, fit: Fit) -> None:
        """Give frames their fitted poses; the map and its keyframes go along."""
        if not fit.poses:
            return
        order = list(self.records)  # as they were tracked
        since = next(n for n, index in enumerate(order) if index in fit.poses)
        before = {index: self._pose(index) for index in order[since:]}
        after, newest = followed(before, fit.poses)
        still = Sim3(1.0, np.eye(3), np.zeros(3))
        moves = [
            moved_by(before[k.index], after[k.index], fit.stretch if k.index in fit.free else 1.0)
            if k.index in after
            else still
            for k in self.mapper.keyframes
        ]
        for part in (self.mapper, self.dormant):
            move_gaussians(part.map, anchors_of(part.born), moves)
        self._move(after)
        self.tracker.carried(newest)
        self.relocaliser.moved(lambda T_wc: newest @ T_wc)

    def _pose(self, index: int) -> NDArray[np.float64]:
        return self.records[index].T_wc

    def _move(self, poses: dict[int, NDArray[np.float64]]) -> None:
        """Give tracked frames new poses T_wc; frames anchored to a keyframe among them follow it."""
        for view in [*self.mapper.keyframes, *self.mapper.frames]:
            view.T_wc = poses.get(view.index, view.T_wc)
        for index, T_wc in poses.items():
            record = self.records[index]
            if record.anchor.index != index:
                record.relative = invert_pose(record.anchor.T_wc) @ T_wc

    def finish(self) -> Estimate:
        if self.depth is None and self.waiting:
            estimate = self.estimator.finish() if self.estimator else None
            if estimate is not None:
                self._initialise(estimate)
        self.dormant.wake(self.mapper)
        self._end()
        self._follow_back()
        self.mapper.polish(self.config.final_iterations * len(self.mapper.keyframes))
        indices = sorted(self.records)
        records = [self.records[i] for i in indices]
        poses = np.array([r.T_wc for r in records]).reshape(-1, 4, 4)
        return Estimate(
            Trajectory(np.array([r.time for r in records]), poses),
            keyframes=sorted(v.index for v in self.mapper.keyframes),
            metric=bool(self.depth and self.depth.metric),
            map=self.mapper.map if len(self.mapper.map) else None,
            frames=self.numbers,
            depth=self.depth,
            extra={"gaussians": len(self.mapper.map), "projection": self._projection(self.camera)},
        )

    def live_map(self) -> LiveMap | None:
        m = self.mapper
        keyframes = np.array([v.T_wc for v in m.keyframes]).reshape(-1, 4, 4)
        whole = self.dormant.whole(m)
        return LiveMap(whole.means, np.clip(whole.colours, 0.0, 1.0), keyframes) if len(whole) else None

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        if not len(self.mapper.map):
            return None
        projection = self._projection(camera)
        renderer = Renderer(camera, projection if projection == camera.kind else "sphere", self.config.low_pass)
        return np.ascontiguousarray(np.clip(renderer.forward(self.dormant.whole(self.mapper), T_wc).colour, 0.0, 1.0))

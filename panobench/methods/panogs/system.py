"""PanoGS-SLAM: monocular panoramic Gaussian splatting SLAM as an online method.

Mao et al., "PanoGS-SLAM: Panoramic 3D Gaussian Splatting SLAM". What differs from the paper is in docs/panogs.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.keyframes import is_keyframe, update_window
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.newdepth import RecentFrames
from panobench.methods.panogs.tracker import OPACITY_MIN, Tracked, Tracker
from panobench.methods.panogs.views import View
from panobench.splat.render import Renderer, RenderOutput
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
        self.recent = RecentFrames(camera, self.config.sweep_frames)
        self.waiting: list[Frame] = []
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
            self.waiting.append(frame)
            estimate = self.estimator.add(frame) if self.estimator else self._constant_depth(frame)
            if estimate is None:
                return None
            self._initialise(estimate)
        else:
            self._process(frame)
        record = self.records.get(frame.index)
        return None if record is None else record.T_wc

    def _blank(self, image: NDArray[np.uint8]) -> bool:
        """Nothing to align or to map: a closed shutter, a saturated sensor, fog."""
        return bool(image[self.tracker.valid].std(axis=0).max() < BLANK_LEVELS)

    def _skip(self, frame: Frame) -> None:
        """No pose for this frame; the motion before it is taken to go on."""
        self.numbers[frame.index] = {"blank": 1.0}
        if self.tracker.T_last is not None:
            self.tracker.T_last = self.tracker.predict()

    def _constant_depth(self, frame: Frame) -> DepthEstimate:
        shape = frame.image.shape[:2]
        return DepthEstimate(np.full(shape, self.config.constant_depth, np.float32), frame.index)

    def _initialise(self, estimate: DepthEstimate) -> None:
        """Build the first map and track the frames that waited for it."""
        self.depth = estimate
        waiting, self.waiting = self.waiting, []
        first = next(f for f in waiting if f.index == estimate.frame_index)
        view = View(first.index, first.image, np.eye(4))
        self.mapper.initialise(view, estimate.depth)
        out = self.renderer.forward(self.mapper.map, view.T_wc, count_touched=True)
        view.touched = out.touched
        self.mapper.add_keyframe(view, [view])
        self.mapper.optimise(self.config.initial_iterations, poses=False)
        self.tracker.reset(view.T_wc)
        self.records[first.index] = _Record(first.time, view, np.eye(4))
        self.numbers[first.index] = {"keyframe": 1.0}
        for frame in waiting:
            if frame.index > first.index:
                hint = estimate.T_wc.get(frame.index)
                self._process(frame, hint)

    def _process(self, frame: Frame, hint: NDArray[np.float64] | None = None) -> None:
        began = time.perf_counter()
        if hint is not None and self.tracker.T_last is not None:
            self.tracker.velocity = invert_pose(self.tracker.T_last) @ hint
        tracked = self.tracker.track(frame.image, self.mapper.map)
        depth = self.mapper.local_depth(tracked.render)
        self.recent.add(frame.index, frame.image, self.tracker.pyramid, tracked.T_wc[:3, 3], depth)
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
        numbers["mapping_s"] = time.perf_counter() - began - numbers["tracking_s"]

    def _map(self, frame: Frame, tracked: Tracked) -> bool:
        """Keyframe decision; for a keyframe insertion, optimisation and pruning."""
        m = self.mapper
        last = m.window[0]
        seen, last_seen = tracked.render.touched, last.touched
        assert seen is not None
        assert last_seen is not None
        view = View(frame.index, frame.image, tracked.T_wc, touched=seen)
        unknown = m.thin(tracked.render) | m.wrong(view, tracked.render)
        new_share = float(m.weights[unknown].sum())
        local = m.local_depth(tracked.render)
        distance = float(np.linalg.norm(view.position - last.position)) / local
        self.numbers.setdefault(frame.index, {})["new_share"] = new_share
        if not is_keyframe(
            self.config, seen > 0, last_seen > 0, distance, frame.index - last.index,
            len(m.window) >= self.config.window, new_share,
        ):  # fmt: skip
            m.frames.append(view)
            return False
        before = len(m.map)
        if self.config.sweep:
            self._insert_swept(self.config.insert_delay, local, self.config.sweep_confidence)
        else:
            m.insert(view, tracked.render)
        grown = max(len(m.map) - before, 0) / m.count
        m.add_keyframe(view, update_window(m.window, view, self.config.window))
        m.optimise(round(self.config.mapping_iterations * (1.0 + min(4.0 * grown, 1.0))))
        m.prune()
        record = self.records[frame.index]
        record.anchor, record.relative = view, np.eye(4)
        velocity = self.tracker.velocity
        self.tracker.reset(view.T_wc, velocity)
        return True

    def _insert_swept(self, delay: int, depth: float, confidence: float) -> None:
        """New Gaussians for what the frame ``delay`` frames ago saw first, from a sweep over the frames since."""
        m, target = self.mapper, self.recent.delayed(delay)
        if target is None:
            return
        view = View(target.index, target.image, self.records[target.index].T_wc)
        render = m.renderer.forward(m.map, view.T_wc, sloped=True)
        if float(m.weights[m.thin(render) | m.wrong(view, render)].sum()) <= self.config.sweep_share:
            return
        swept = self.recent.sweep(target, lambda i: self.records[i].T_wc, 0.1 * depth, 15.0 * depth, depth, confidence)
        if swept is not None:
            m.insert(view, render, self._at_map_scale(swept, view, render))

    def _at_map_scale(self, swept: NDArray[np.float32], view: View, render: RenderOutput) -> NDArray[np.float32]:
        """Swept depth scaled to agree with the map where the map knows.

        The sweep inherits the scale of the last poses, and poses that of the map they were tracked against; handing
        it on to new parts of the map would compound every small error.
        """
        m = self.mapper
        ratio = render.expected_depth(OPACITY_MIN) / swept
        known = np.isfinite(ratio) & (m.weights > 0) & ~m.wrong(view, render)
        if np.count_nonzero(known) < 0.05 * known.size:
            return swept
        return swept * np.float32(np.clip(np.median(ratio[known]), 0.8, 1.25))

    def finish(self) -> Estimate:
        if self.depth is None and self.waiting:
            estimate = self.estimator.finish() if self.estimator else None
            if estimate is not None:
                self._initialise(estimate)
        if self.config.final_iterations and self.mapper.keyframes:
            self.mapper.window = list(self.mapper.keyframes)
            self.mapper.optimise(self.config.final_iterations, poses=False)
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
        return LiveMap(m.map.means, np.clip(m.map.colours, 0.0, 1.0), keyframes) if len(m.map) else None

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        if not len(self.mapper.map):
            return None
        projection = self._projection(camera)
        renderer = Renderer(camera, projection if projection == camera.kind else "sphere", self.config.low_pass)
        return np.ascontiguousarray(np.clip(renderer.forward(self.mapper.map, T_wc).colour, 0.0, 1.0))

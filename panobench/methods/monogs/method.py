"""``monogs``: MonoGS as published, on panobench's renderer.

Matsuki, Murai, Kelly, Davison, "Gaussian Splatting SLAM" (CVPR 2024), monocular: tracking and mapping by Adam on the
rendering loss from nothing but images. Written from the paper and its published settings; see docs/methods/monogs.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise
from panobench.methods.base import MethodContext, OnlineMethod
from panobench.methods.monogs.config import MonogsConfig
from panobench.methods.monogs.mapper import Keyframe, MonogsMapper, median_depth
from panobench.methods.monogs.tracker import TrackedFrame, track
from panobench.methods.splatting.covisibility import overlap
from panobench.splat.render import Renderer
from panobench.types import Estimate, Frame, Trajectory

Array = NDArray[np.float64]


@dataclass
class _Record:
    """A frame tied to the keyframe it was tracked after, whose refinement it follows."""

    time: float
    anchor: Keyframe
    relative: Array


class MonogsMethod(OnlineMethod):
    """Poses are in the first frame's axes; the first depth of 2 sets the scale."""

    config: MonogsConfig

    def __init__(self, config: MonogsConfig | None = None) -> None:
        super().__init__(config or MonogsConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.camera, self.context = camera, context
        self.renderer = Renderer(camera, self.config.projection, self.config.low_pass)
        self.rng = np.random.default_rng(context.seed)
        self.valid = camera.valid_mask()
        self.mapper: MonogsMapper | None = None
        self.T_last = np.eye(4)
        self.records: dict[int, _Record] = {}
        self.numbers: dict[int, dict[str, float]] = {}
        self.keyframes: list[int] = []
        self.restarts = 0

    def track(self, frame: Frame) -> Array | None:
        began = time.perf_counter()
        if self.mapper is None:
            if not frame.mappable or int(np.ptp(frame.image[self.valid])) < 10:
                return None  # a blank image cannot start anything
            self._begin(frame, np.eye(4))
            self.numbers[frame.index]["mapping_s"] = time.perf_counter() - began
            return self.T_last.copy()
        found = track(self.config, self.renderer, self.mapper.map.gaussians, frame.image, self.valid, self.T_last)
        numbers = {
            "tracking_s": time.perf_counter() - began,
            "loss": found.loss,
            "iterations": float(found.iterations),
            "gaussians": float(len(self.mapper.map)),
        }
        self.numbers[frame.index] = numbers
        if not np.isfinite(found.T_wc).all():
            return None
        self.T_last = found.T_wc
        newest = self.mapper.window[0]
        self.records[frame.index] = _Record(frame.time, newest, invert_pose(newest.T_wc) @ found.T_wc)
        if frame.mappable and self._wants_keyframe(self.mapper, frame, found):
            self._add_keyframe(self.mapper, frame, found)
        numbers["mapping_s"] = time.perf_counter() - began - numbers["tracking_s"]
        return self.T_last.copy()

    def _begin(self, frame: Frame, T_wc: Array) -> None:
        """A map from this frame alone."""
        self.mapper = MonogsMapper(self.camera, self.renderer, self.config, self.rng)
        view = self.mapper.keyframe(frame.index, frame.image, T_wc, 0.0, 0.0)
        self.mapper.begin(view)
        self.T_last = T_wc
        self.records[frame.index] = _Record(frame.time, view, np.eye(4))
        self.numbers.setdefault(frame.index, {})["keyframe"] = 1.0
        self.keyframes.append(frame.index)

    def _wants_keyframe(self, mapper: MonogsMapper, frame: Frame, found: TrackedFrame) -> bool:
        """By co-visibility alone until the window is full; then by co-visibility and translation over depth."""
        c, last = self.config, mapper.window[0]
        assert found.render.touched is not None
        assert last.seen is not None
        common = overlap(mapper.seen(found.render.touched), last.seen, mapper.map.ids)
        if len(mapper.window) < c.window:
            return frame.index - last.index >= c.keyframe_interval and common < c.keyframe_overlap
        depth, _ = median_depth(found.render, self.valid)
        moved = float(np.linalg.norm(found.T_wc[:3, 3] - last.T_wc[:3, 3]))
        far = moved > c.keyframe_max_rel * depth
        return far or (common < c.keyframe_overlap and moved > c.keyframe_min_rel * depth)

    def _add_keyframe(self, mapper: MonogsMapper, frame: Frame, found: TrackedFrame) -> None:
        view = mapper.keyframe(frame.index, frame.image, found.T_wc, found.gain, found.offset)
        assert found.render.touched is not None
        view.seen = mapper.seen(found.render.touched)
        if not mapper.extend(view, found.render):
            # The first window broke apart: the map is not to be trusted.
            self.restarts += 1
            self.context.log(f"frame {frame.index}: the first keyframes do not overlap; a new map begins here")
            self._begin(frame, found.T_wc)
            return
        self.numbers[frame.index]["mapping_loss"] = mapper.optimise()
        self.numbers[frame.index]["keyframe"] = 1.0
        self.keyframes.append(frame.index)
        self.T_last = view.T_wc
        self.records[frame.index] = _Record(frame.time, view, np.eye(4))

    def finish(self) -> Estimate:
        if self.mapper is None:
            return Estimate(Trajectory(np.empty(0), np.empty((0, 4, 4))))
        self.mapper.refine_colours(self.config.final_iterations)
        records = [self.records[i] for i in sorted(self.records)]
        poses = np.stack([renormalise(r.anchor.T_wc @ r.relative) for r in records])
        return Estimate(
            Trajectory(np.array([r.time for r in records]), poses),
            keyframes=self.keyframes,
            map=self.mapper.map.gaussians if len(self.mapper.map) else None,
            frames=self.numbers,
            extra={"gaussians": len(self.mapper.map), "restarts": self.restarts},
        )

    def render(self, camera: Camera, T_wc: Array) -> NDArray[np.float32] | None:
        """As ``OnlineMethod.render``."""
        if self.mapper is None or not len(self.mapper.map):
            return None
        projection = self.config.projection if camera.kind == "pinhole" else "sphere"
        out = Renderer(camera, projection, self.config.low_pass).forward(self.mapper.map.gaussians, T_wc)
        return np.ascontiguousarray(np.clip(out.colour, 0.0, 1.0))

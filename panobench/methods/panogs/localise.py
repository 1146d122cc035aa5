"""Localisation: where each frame was taken in a saved map, which stays as it is."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import UsageError
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.continuation import add_places
from panobench.methods.panogs.exposure import ExposureMatcher
from panobench.methods.panogs.place_recognition import Places
from panobench.methods.panogs.relocalise import Relocaliser
from panobench.methods.panogs.tracker import Tracker
from panobench.methods.splatting.views import View
from panobench.photometric.overlap import ViewWidth
from panobench.splat.render import Renderer
from panobench.types import Estimate, Frame, Trajectory

Pose = NDArray[np.float64]


class LocaliseMethod(OnlineMethod):
    """One frame is: track, judge. A frame that the map does not explain has no pose.

    The camera may be another than the one that mapped.
    """

    config: PanogsConfig

    def __init__(self, config: PanogsConfig | None = None) -> None:
        super().__init__(config or PanogsConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        if context.saved_map is None:
            raise UsageError("localising needs a saved map (--continue DIR)")
        c, self.saved, self.camera = self.config, context.saved_map, camera
        renderer = Renderer(camera, "sphere", c.rendering.low_pass, stop=1e-3)
        self.renderer = renderer
        self.tracker = Tracker(camera, renderer, c)
        self.keyframes = [View(k.index, k.image[:0], k.T_wc) for k in self.saved.keyframes]
        places = Places(camera)
        add_places(places, self.saved.gaussians, [k.T_wc for k in self.keyframes], renderer)
        # What has changed since stays changed, so every frame is compared; a search never becomes a short one.
        options = replace(c.relocalisation, unusual=0.0, patience=1 << 30)
        self.relocaliser = Relocaliser(self.tracker, places, options)
        self.relocaliser.strict = True
        self.exposure = ExposureMatcher(self.tracker.weights, ViewWidth.of(camera), c.exposure)
        self.tracker.reset(self.keyframes[0].T_wc)
        self.relocaliser.interrupted()
        self.poses: dict[int, Pose] = {}
        self.times: dict[int, float] = {}
        self.numbers: dict[int, dict[str, float]] = {}

    def track(self, frame: Frame) -> Pose | None:
        began = time.perf_counter()
        gaussians = self.saved.gaussians
        tracked = self.tracker.track(self.exposure.before(frame.image), gaussians)
        trusted = self.relocaliser.judge(tracked, gaussians, self.keyframes)
        if trusted is None:
            self.numbers[frame.index] = {"lost": 1.0, "tracking_s": time.perf_counter() - began}
            return None
        self.exposure.after(frame.image, trusted.render)
        self.poses[frame.index], self.times[frame.index] = trusted.T_wc, frame.time
        self.numbers[frame.index] = {
            "tracking_s": time.perf_counter() - began,
            "loss": trusted.cost,
            "agreement": self.relocaliser.agreed,
        }
        return trusted.T_wc

    def finish(self) -> Estimate:
        indices = sorted(self.poses)
        trajectory = Trajectory(
            np.array([self.times[i] for i in indices]),
            np.array([self.poses[i] for i in indices]).reshape(-1, 4, 4),
        )
        return Estimate(trajectory, metric=self.saved.metric, map=self.saved.gaussians, frames=self.numbers)

    def known_poses(self) -> dict[int, Pose]:
        return dict(self.poses)

    def live_map(self) -> LiveMap:
        g = self.saved.gaussians
        return LiveMap(g.means, np.clip(g.colours, 0.0, 1.0), np.array([v.T_wc for v in self.keyframes]))

    def render(self, camera: Camera, T_wc: Pose) -> NDArray[np.float32]:
        renderer = Renderer(camera, "sphere", self.config.rendering.low_pass)
        return np.ascontiguousarray(np.clip(renderer.forward(self.saved.gaussians, T_wc).colour, 0.0, 1.0))

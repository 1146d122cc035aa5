"""Localisation: where each frame was taken in a map that stays as it is."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import UsageError
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.factor_graph.place_recognition import Places
from panobench.methods.panogs.several_maps.continuation import add_places
from panobench.methods.panogs.tracking.exposure import ExposureMatcher
from panobench.methods.panogs.tracking.relocalise import Relocaliser
from panobench.methods.panogs.tracking.tracker import Tracked, Tracker
from panobench.methods.splatting.views import View
from panobench.photometric.overlap import ViewWidth
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.types import Estimate, Frame, Trajectory

Pose = NDArray[np.float64]


class Localiser:
    """Tracks a camera in a map; it begins lost. A pose must show itself in fine detail, in every frame.

    keyframes: of the map, with a thumbnail each in ``places``. patience: frames with the larger number of starts.
    """

    def __init__(
        self, renderer: Renderer, config: PanogsConfig, keyframes: Sequence[View], places: Places, patience: int
    ) -> None:
        self.keyframes, self.tracker = keyframes, Tracker(renderer.camera, renderer, config)
        # What has changed since the map was made stays changed, so every frame is compared.
        options = replace(config.relocalisation, unusual=0.0, patience=patience)
        self.relocaliser = Relocaliser(self.tracker, places, options)
        self.relocaliser.strict = True
        self.exposure = ExposureMatcher(self.tracker.weights, ViewWidth.of(renderer.camera), config.exposure)
        self.tracker.reset(keyframes[-1].T_wc)
        self.relocaliser.interrupted()

    def look(self, frame: Frame, gaussians: GaussianMap) -> Tracked | None:
        """The frame in the map; None if the map does not explain it."""
        tracked = self.tracker.track(self.exposure.before(frame.image), gaussians, frame.mask)
        trusted = self.relocaliser.judge(tracked, gaussians, self.keyframes)
        if trusted is not None:
            self.exposure.after(frame.image, trusted.render)
        return trusted


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
        self.saved = saved = context.saved_map
        renderer = Renderer(camera, "sphere", self.config.rendering.low_pass, stop=1e-3)
        self.keyframes = [View(k.index, k.image[:0], k.T_wc) for k in saved.keyframes]
        places = Places(camera)
        add_places(places, saved.gaussians, [k.T_wc for k in self.keyframes], renderer)
        self.localiser = Localiser(renderer, self.config, self.keyframes, places, patience=1 << 30)
        self.poses: dict[int, Pose] = {}
        self.times: dict[int, float] = {}
        self.numbers: dict[int, dict[str, float]] = {}

    def track(self, frame: Frame) -> Pose | None:
        began = time.perf_counter()
        trusted = self.localiser.look(frame, self.saved.gaussians)
        if trusted is None:
            self.numbers[frame.index] = {"lost": 1.0, "tracking_s": time.perf_counter() - began}
            return None
        self.poses[frame.index], self.times[frame.index] = trusted.T_wc, frame.time
        self.numbers[frame.index] = {
            "tracking_s": time.perf_counter() - began,
            "loss": trusted.cost,
            "agreement": self.localiser.relocaliser.agreed,
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

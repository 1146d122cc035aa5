"""``photoslam``: geometric tracking with a Gaussian map, Photo-SLAM's composition.

Huang, Li, Cheng, Yeung, "Photo-SLAM" (CVPR 2024): a feature SLAM system finds the poses, a Gaussian map is trained on
its keyframes and starts from its points. Here ``sparse`` is the feature system, so panoramas work like pinholes; the
map learns in ``track`` instead of in a thread of its own, which keeps results repeatable and the time honest.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.base import MethodContext, OnlineMethod
from panobench.methods.photoslam.config import PhotoslamConfig
from panobench.methods.photoslam.mapper import PhotoslamMapper
from panobench.methods.sparse.method import SparseMethod
from panobench.methods.sparse.session import Session
from panobench.splat.render import Renderer
from panobench.types import Estimate, Frame

Array = NDArray[np.float64]

#: Images kept at most while no map has started.
WAITING = 200


class PhotoslamMethod(OnlineMethod):
    """Hands frames to ``sparse`` and its keyframes to the mapper; each of its maps has Gaussians of its own."""

    config: PhotoslamConfig

    def __init__(self, config: PhotoslamConfig | None = None) -> None:
        super().__init__(config or PhotoslamConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.camera, self.context = camera, context
        self.tracking = SparseMethod(self.config.tracking)
        self.tracking.start(camera, context)
        self.maps: list[tuple[Session, PhotoslamMapper]] = []
        self.images: dict[int, NDArray[np.uint8]] = {}
        self.numbers: dict[int, dict[str, float]] = {}
        self.chosen: PhotoslamMapper | None = None

    def track(self, frame: Frame) -> Array | None:
        began = time.perf_counter()
        T_wc = self.tracking.track(frame)
        tracked = time.perf_counter()
        session = self.tracking.session
        if frame.mappable:  # images wait for their keyframe only while a map is being started
            self.images[frame.index] = frame.image
            if len(self.images) > WAITING:
                del self.images[next(iter(self.images))]
        if session is not None:
            self._map(session)
        self.numbers[frame.index] = {
            "tracking_s": tracked - began,
            "mapping_s": time.perf_counter() - tracked,
            "gaussians": float(len(self.maps[-1][1].map)) if self.maps else 0.0,
        }
        return T_wc

    def _map(self, session: Session) -> None:
        """Give the mapper the keyframes that are new since the last frame."""
        mapper = next((m for s, m in self.maps if s is session), None)
        if mapper is None:
            mapper = PhotoslamMapper(self.camera, self.config, self.context.seed)
            self.maps.append((session, mapper))
        fresh = session.map.keyframes[mapper.known :]
        if fresh:
            mapper.follow(session.map)
            mapper.known = len(session.map.keyframes)
            for k in fresh:
                if k.frame in self.images:
                    mapper.add(session.map, k.number, k.frame, self.images[k.frame])
        self.images.clear()

    def finish(self) -> Estimate:
        answer = self.tracking.finish()
        former = [*self.tracking.previous, *([self.tracking.session] if self.tracking.session else [])]
        if former and self.maps:
            best = max(former, key=lambda s: len(s.records))  # the one ``sparse`` answers with
            self.chosen = next((m for s, m in self.maps if s is best), None)
        frames = {i: {**self.numbers.get(i, {}), **answer.frames.get(i, {})} for i in self.numbers}
        if self.chosen is None:
            return dataclasses.replace(answer, frames=frames)
        self.chosen.follow(best.map)
        self.chosen.finish()
        gaussians = self.chosen.map.gaussians
        return dataclasses.replace(
            answer,
            frames=frames,
            map=gaussians if len(gaussians) else None,
            extra={**answer.extra, "gaussians": len(gaussians)},
        )

    def render(self, camera: Camera, T_wc: Array) -> NDArray[np.float32] | None:
        """As ``OnlineMethod.render``."""
        mapper = self.chosen or (self.maps[-1][1] if self.maps else None)
        if mapper is None or not len(mapper.map):
            return None
        out = Renderer(camera, "sphere", self.config.low_pass).forward(mapper.map.gaussians, T_wc)
        return np.ascontiguousarray(np.clip(out.colour, 0.0, 1.0))

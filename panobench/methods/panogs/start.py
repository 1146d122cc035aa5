"""The start: frames wait until the depth of one of them is known, from which the first map is built."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from panobench.cameras.base import Camera
from panobench.cameras.row_times import rates_along
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import StartOptions
from panobench.methods.panogs.exposure import ExposureMatcher
from panobench.methods.panogs.rolling_shutter import RollingShutter
from panobench.types import DepthEstimate, Frame

#: From so many frames an unknown readout of a rolling shutter is estimated.
READOUT_FRAMES = 20


@dataclass(frozen=True)
class FirstMap:
    """What the map starts from.

    depth: radial depth of ``first``, with poses of some of the other frames. first: as a global shutter would have seen
    it. frames: all that waited, in order, as they came.
    """

    depth: DepthEstimate
    first: Frame
    frames: list[Frame]


class Start:
    """Collects frames until its estimator has the depth of one of them. Without an estimator the depth is constant."""

    def __init__(
        self,
        camera: Camera,
        context: MethodContext,
        options: StartOptions,
        exposure: ExposureMatcher,
        shutter: RollingShutter,
    ) -> None:
        self.camera, self.context, self.options = camera, context, options
        self.exposure, self.shutter = exposure, shutter
        self.estimator = context.make_depth() if context.make_depth else None
        if self.estimator:
            self.estimator.start(camera, context.seed)
        self.frames: list[Frame] = []
        self.held: DepthEstimate | None = None  # while more frames have to tell the readout

    def add(self, frame: Frame) -> FirstMap | None:
        """Take the next frame; answers as soon as a map can be started."""
        if not self.frames:
            if not frame.mappable:  # the map begins with a frame that it may see
                return None
            self.exposure.start(frame.image)
        self.frames.append(frame)
        if self.held is None:
            self.held = self._estimate(frame)
        few = self.shutter.unknown and len(self.frames) < READOUT_FRAMES
        return None if self.held is None or few else self._first_map(self.held)

    def finish(self) -> FirstMap | None:
        """No more frames come: the best that can be said, if anything."""
        if not self.frames:
            return None
        if self.held is None and self.estimator is not None:
            self.held = self.estimator.finish()
        return None if self.held is None else self._first_map(self.held)

    def _estimate(self, frame: Frame) -> DepthEstimate | None:
        if self.estimator is not None:
            return self.estimator.add(replace(frame, image=self.exposure.before(frame.image)))
        return DepthEstimate(np.full(frame.image.shape[:2], self.options.constant_depth, np.float32), frame.index)

    def _first_map(self, estimate: DepthEstimate) -> FirstMap:
        if estimate.message:
            (self.context.log if estimate.ok else self.context.warn)(estimate.message)
        frames, self.frames, self.held = self.frames, [], None
        self.shutter.estimate(frames, self.context.seed, self.context.log)
        rolling = self.shutter.enabled and len(estimate.T_wc) > 2
        if rolling:
            estimate = self._estimate_rectified(frames, estimate)
        first = next(f for f in frames if f.index == estimate.frame_index)
        motion = self.shutter.motion(first.index) if rolling else None
        if motion is not None:
            first = replace(first, image=self.shutter.rectified(first.image, *motion, estimate.depth))
        return FirstMap(estimate, first, frames)

    def _estimate_rectified(self, frames: list[Frame], estimate: DepthEstimate) -> DepthEstimate:
        """Another estimate, from the frames rectified by the poses of the first one as far as they go."""
        posed = [f for f in frames if f.index in estimate.T_wc]
        T_wc = np.stack([estimate.T_wc[f.index] for f in posed])
        rates = rates_along(np.array([f.time for f in posed]), T_wc)
        assert self.context.make_depth is not None
        estimator = self.context.make_depth()
        estimator.start(self.camera, self.context.seed)
        found: DepthEstimate | None = None
        for frame, rate in zip(posed, rates):
            image = self.exposure.before(self.shutter.rectified(frame.image, rate))
            found = estimator.add(replace(frame, image=image))
            if found is not None:
                break
        found = found or estimator.finish() or estimate
        if len(found.T_wc) > 2:
            self.shutter.know(frames, found.T_wc)
        return found

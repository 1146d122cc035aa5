"""The start: frames wait until the depth of one of them is known, from which the first map is built."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from panobench.cameras.base import Camera
from panobench.cameras.row_times import rates_along
from panobench.geometry import invert_pose
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import StartOptions
from panobench.methods.panogs.first_map import tracks as first_tracks
from panobench.methods.panogs.first_map.exposure_chain import ExposureChain
from panobench.methods.panogs.rectification.rectify import Rectifier
from panobench.photometric.pyramid import F32
from panobench.types import DepthEstimate, Frame


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
        exposure: ExposureChain,
        rectifier: Rectifier,
    ) -> None:
        self.camera, self.context, self.options = camera, context, options
        self.exposure, self.rectifier = exposure, rectifier
        self.shutter, self.seam = rectifier.shutter, rectifier.seam
        self.estimator = context.make_depth() if context.make_depth else None
        if self.estimator:
            self.estimator.start(camera, context.seed)
        self.frames: list[Frame] = []
        self.held: DepthEstimate | None = None  # while more frames have to tell of the camera

    def add(self, frame: Frame) -> FirstMap | None:
        """Take the next frame; answers as soon as a map can be started."""
        if not self.frames:
            if not frame.mappable:  # the map begins with a frame that it may see
                return None
            self.exposure.start(frame.image, frame.mask)
        self.frames.append(frame)
        if self.held is None:
            self.held = self._estimate(frame)
        few = self._learns and len(self.frames) < first_tracks.FRAMES
        return None if self.held is None or few else self._first_map(self.held)

    @property
    def _learns(self) -> bool:
        """Whether feature tracks have something to tell."""
        return self.shutter.unknown or self.seam.stitched

    def finish(self) -> FirstMap | None:
        """No more frames come: the best that can be said, if anything."""
        if not self.frames:
            return None
        if self.held is None and self.estimator is not None:
            self.held = self.estimator.finish()
        return None if self.held is None else self._first_map(self.held)

    def _estimate(self, frame: Frame) -> DepthEstimate | None:
        if self.estimator is not None:
            return self.estimator.add(replace(frame, image=self.exposure.follow(frame.image, frame.mask)))
        return DepthEstimate(np.full(frame.image.shape[:2], self.options.constant_depth, np.float32), frame.index)

    def _first_map(self, estimate: DepthEstimate) -> FirstMap:
        if estimate.message:
            (self.context.log if estimate.ok else self.context.warn)(estimate.message)
        frames, self.frames, self.held = self.frames, [], None
        if self._learns:
            first_tracks.learn_from_tracks(self.camera, frames, estimate.T_wc, self.shutter, self.seam, self.context)
        rectifies = self.rectifier.enabled and len(estimate.T_wc) > 2
        if rectifies:
            failed, estimate = not estimate.ok, self._estimate_rectified(frames, estimate)
            if failed and estimate.ok:
                self.context.log(f"rectified: {estimate.message}")
        first = next(f for f in frames if f.index == estimate.frame_index)
        if rectifies:
            still = np.zeros(3), np.zeros(3)
            rate, velocity = self.shutter.motion(first.index) or still
            image = self.rectifier.rectified(first.image, rate, velocity, estimate.depth)
            first = replace(first, image=image, mask=self.seam.visible(estimate.depth, first.mask))
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
        self.exposure.start(posed[0].image, posed[0].mask)
        for frame, rate in zip(posed, rates):
            image = self.rectifier.turned(frame.image, rate)
            if self.seam.lenses is not None:
                depth_map = self._seen_from(estimate, frame.index)
                image = self.rectifier.rectified(frame.image, rate, np.zeros(3), depth_map)
            found = estimator.add(replace(frame, image=self.exposure.follow(image, frame.mask)))
            if found is not None:
                break
        found = found or estimator.finish() or estimate
        if len(found.T_wc) > 2:
            self.shutter.know(frames, found.T_wc)
        return found

    def _seen_from(self, estimate: DepthEstimate, index: int) -> F32:
        """The first depth (H, W) turned to another frame; what that frame has moved is small beside the depth."""
        T = invert_pose(estimate.T_wc[estimate.frame_index]) @ estimate.T_wc[index]
        pixels, _ = self.camera.project((np.nan_to_num(self.camera.rays()) @ T[:3, :3].T).reshape(-1, 3))
        h, w = estimate.depth.shape
        u, v = np.floor(np.nan_to_num(pixels)).astype(int).T
        return estimate.depth[np.clip(v, 0, h - 1), np.mod(u, w)].reshape(h, w)

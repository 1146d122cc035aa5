"""Depth of the first frame from the first frames themselves: no weights, no features, no scale.

Alternates (a) direct alignment of the frames to the first with the current depth, constant at first, and (b) a plane
sweep with those poses. Each improves the other; the scale is free and set to a median depth of 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.geometry import invert_pose, renormalise
from panobench.photometric.align import AlignOptions, align, make_reference
from panobench.photometric.bundle import refine
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama
from panobench.photometric.warp import camera_code
from panobench.types import DepthEstimate, Frame


@dataclass(frozen=True)
class BootstrapOptions:
    """coarse_width, fine_width: the two working widths. parallax_rad: translation over depth that ends the wait
    (parallax_fast_rad already after min_frames); frames: most used for the sweep; wait: most frames to wait.
    rounds, fine_rounds: sweeps at either width. near, far: sweep range over the median depth.
    """

    coarse_width: int = 256
    fine_width: int = 512
    parallax_rad: float = 0.12
    parallax_fast_rad: float = 0.22
    min_frames: int = 4
    frames: int = 12
    wait: int = 60
    rounds: int = 2
    fine_rounds: int = 1
    near: float = 0.2
    far: float = 15.0
    sweep: SweepOptions = field(default_factory=SweepOptions)


MEDIAN_DEPTH = 2.0


class BootstrapDepth(DepthEstimator):
    """Buffers frames until they have parallax, then solves for depth and poses together."""

    def __init__(self, argument: str = "", options: BootstrapOptions = BootstrapOptions()) -> None:
        super().__init__(argument)
        self.options = options

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.full, self.wrap = camera, camera.kind == "erp"
        self.full_valid = camera.valid_mask()
        self.code = camera_code(camera)[0]
        self.coarse = WorkingScale.of(camera, self.options.coarse_width)
        self.fine = WorkingScale.of(camera, self.options.fine_width)
        self.align_options = AlignOptions(exposure=True)
        self.frames: list[Frame] = []
        self.pyramids: list[list[F32]] = []
        self.T_fr: list[NDArray[np.float64]] = []

    # -- taking frames -------------------------------------------------------------------------------------------

    def add(self, frame: Frame) -> DepthEstimate | None:
        o = self.options
        self.frames.append(frame)
        self.pyramids.append(pyramid(luma_of_frame(frame.image, self.full_valid)))
        self.T_fr.append(np.eye(4))
        if len(self.frames) == 1:
            self._set_reference(self.coarse, np.full(self.coarse.valid.shape, MEDIAN_DEPTH, np.float32))
            return None
        self._align(len(self.frames) - 1, self.coarse, self._predicted())
        parallax, n = self._parallax(), len(self.frames)
        enough = n >= o.frames and parallax >= o.parallax_rad
        enough |= n >= o.min_frames and parallax >= o.parallax_fast_rad
        return self._solve() if enough or n >= o.wait else None

    def finish(self) -> DepthEstimate | None:
        if not self.frames:
            return None
        return self._solve() if len(self.frames) >= 3 else self._constant("too few frames")

    def _constant(self, why: str) -> DepthEstimate:
        depth = np.full((self.full.height, self.full.width), MEDIAN_DEPTH, np.float32)
        return DepthEstimate(depth, self.frames[0].index, ok=False, message=f"bootstrap: {why}; constant depth")

    def _parallax(self) -> float:
        """Largest translation from the first frame over the scene's median depth."""
        return max(float(np.linalg.norm(T[:3, 3])) for T in self.T_fr) / MEDIAN_DEPTH

    def _predicted(self) -> NDArray[np.float64]:
        """Constant velocity for the newest frame from the two before it."""
        if len(self.T_fr) < 3:
            return self.T_fr[-2]
        return renormalise(self.T_fr[-2] @ invert_pose(self.T_fr[-3]) @ self.T_fr[-2])

    def _set_reference(self, scale: WorkingScale, depth: F32) -> None:
        levels = self.pyramids[0][scale.level :]
        masked = np.where(scale.valid, depth, np.nan).astype(np.float32)
        self.reference = make_reference(scale.camera, levels[0], masked, len(levels), self.align_options)

    def _align(self, k: int, scale: WorkingScale, T_fr: NDArray[np.float64]) -> None:
        self.T_fr[k] = align(self.reference, self.pyramids[k][scale.level :], T_fr, self.align_options).T_fr

    # -- solving -------------------------------------------------------------------------------------------------

    def _solve(self) -> DepthEstimate:
        """Rounds of sweep, alignment and joint refinement, first small, then at the fine width."""
        o, n = self.options, len(self.frames)
        used = np.unique(np.linspace(1, n - 1, min(o.frames, n - 1)).round().astype(int))
        near, far, scale = o.near, o.far, self.coarse
        depth = np.full(scale.valid.shape, MEDIAN_DEPTH, np.float32)
        confidence = np.zeros_like(depth)
        for round_ in range(o.rounds + o.fine_rounds):
            if round_ == o.rounds:
                depth = resize_panorama(depth, self.fine.valid.shape, self.wrap)
                scale = self.fine
                self._bundle(used, depth, scale)
            depth, confidence = self._sweep(used, near, far, scale)
            factor = MEDIAN_DEPTH / float(np.median(depth[scale.valid]))
            depth *= np.float32(factor)
            for T in self.T_fr:
                T[:3, 3] *= factor
            self._set_reference(scale, depth)
            for k in range(1, n):
                self._align(k, scale, self.T_fr[k])
            if round_ < o.rounds:
                self._bundle(used, depth, scale)
            if round_ >= 1:  # the coarse shape is known: spend the shells on the range that occurs
                low, high = np.percentile(depth[scale.valid], [0.5, 99.5]) / MEDIAN_DEPTH
                near, far = max(0.7 * float(low), o.near), min(1.4 * float(high), o.far)
        size = (self.full.height, self.full.width)
        return DepthEstimate(
            resize_panorama(depth, size, self.wrap),
            self.frames[0].index,
            resize_panorama(np.where(scale.valid, confidence, 0).astype(np.float32), size, self.wrap),
            {f.index: invert_pose(T) for f, T in zip(self.frames, self.T_fr)},
            message=f"bootstrap: {n} frames, parallax {np.rad2deg(self._parallax()):.1f} deg",
        )

    def _sweep(self, used: NDArray[np.intp], near: float, far: float, scale: WorkingScale) -> tuple[F32, F32]:
        """Depth and confidence (H, W) from the current poses of the frames ``used``."""
        T = np.stack([self.T_fr[k] for k in used])
        luma = self.pyramids[0][scale.level]
        near, far = near * MEDIAN_DEPTH, far * MEDIAN_DEPTH
        return multi_view_depth(luma, scale, self._images(used, scale), T, near, far, self.options.sweep)

    def _images(self, used: NDArray[np.intp], scale: WorkingScale) -> F32:
        return np.stack([self.pyramids[k][scale.level] for k in used])

    def _bundle(self, used: NDArray[np.intp], depth: F32, scale: WorkingScale) -> None:
        """Poses of the frames ``used`` and depths together; the other frames follow at the next alignment."""
        T = np.stack([self.T_fr[k] for k in used])
        luma = self.pyramids[0][scale.level]
        T, _ = refine(luma, scale.rays, depth, self._images(used, scale), T, self.code, scale.cam)
        for k, pose in zip(used, T):
            self.T_fr[k] = pose

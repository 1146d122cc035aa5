"""Depth of the first frame from the first frames themselves: no weights, no features, no scale.

Alternates (a) direct alignment of the frames to the first with the current depth, constant at first, and (b) a plane
sweep with those poses. Each improves the other; the scale is free and set to a median depth of 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.geometry import invert_pose, renormalise
from panobench.photometric.align import AlignOptions, align, make_reference
from panobench.photometric.bundle import refine
from panobench.photometric.planar import depth_information, planar_filter
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.sweep import pick_shell, semi_global, smooth_cost, sweep_cost
from panobench.photometric.warp import camera_code
from panobench.types import DepthEstimate, Frame


@dataclass(frozen=True)
class BootstrapOptions:
    """coarse_width, fine_width: the two working widths. parallax_rad: translation over depth that ends the wait
    (parallax_fast_rad already after min_frames); frames: most used for the sweep; wait: most frames to wait.
    rounds, fine_rounds: sweeps at either width. shells, near, far: sweep range over the median depth.
    """

    coarse_width: int = 256
    fine_width: int = 512
    parallax_rad: float = 0.12
    parallax_fast_rad: float = 0.3
    min_frames: int = 4
    frames: int = 12
    wait: int = 60
    rounds: int = 2
    fine_rounds: int = 1
    shells: int = 48
    near: float = 0.2
    far: float = 15.0
    sigma_px: float = 1.0
    truncation: float = 0.15
    p1: float = 0.001
    p2: float = 0.02
    edge: float = 20.0
    planar_radius: int = 12
    planar_stride: int = 2
    planar_luma: float = 0.05
    planar_depth: float = 0.03
    planar_floor: float = 0.01


MEDIAN_DEPTH = 2.0


@dataclass(frozen=True)
class _Scale:
    """One working width: its camera, rays (H, W, 3), valid pixels, kernel parameters and pyramid level."""

    camera: Camera
    rays: F32
    valid: NDArray[np.bool_]
    cam: F32
    level: int

    @classmethod
    def of(cls, camera: Camera, level: int) -> _Scale:
        scaled = camera.scaled(camera.width >> level) if level else camera
        rays = np.nan_to_num(scaled.rays()).astype(np.float32)
        return cls(scaled, rays, scaled.valid_mask(), camera_code(scaled)[1], level)


class BootstrapDepth(DepthEstimator):
    """Buffers frames until they have parallax, then solves for depth and poses together."""

    def __init__(self, argument: str = "", options: BootstrapOptions = BootstrapOptions()) -> None:
        super().__init__(argument)
        self.options = options

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.full, self.wrap = camera, camera.kind == "erp"
        self.full_valid = camera.valid_mask()
        self.code = camera_code(camera)[0]
        self.coarse = _Scale.of(camera, self._level(self.options.coarse_width))
        self.fine = _Scale.of(camera, self._level(self.options.fine_width))
        self.align_options = AlignOptions(exposure=True)
        self.frames: list[Frame] = []
        self.pyramids: list[list[F32]] = []
        self.T_fr: list[NDArray[np.float64]] = []

    def _level(self, width: int) -> int:
        """Pyramid level of the largest width not above ``width`` that halving reaches."""
        level, size = 0, (self.full.width, self.full.height)
        while size[0] > width and size[0] % 2 == 0 and size[1] % 2 == 0:
            level, size = level + 1, (size[0] // 2, size[1] // 2)
        return level

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

    def _set_reference(self, scale: _Scale, depth: F32) -> None:
        levels = self.pyramids[0][scale.level :]
        masked = np.where(scale.valid, depth, np.nan).astype(np.float32)
        self.reference = make_reference(scale.camera, levels[0], masked, len(levels), self.align_options)

    def _align(self, k: int, scale: _Scale, T_fr: NDArray[np.float64]) -> None:
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
                depth = _resize(depth, self.fine.valid.shape, self.wrap)
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
            _resize(depth, size, self.wrap),
            self.frames[0].index,
            _resize(np.where(scale.valid, confidence, 0).astype(np.float32), size, self.wrap),
            {f.index: invert_pose(T) for f, T in zip(self.frames, self.T_fr)},
            message=f"bootstrap: {n} frames, parallax {np.rad2deg(self._parallax()):.1f} deg",
        )

    def _sweep(self, used: NDArray[np.intp], near: float, far: float, scale: _Scale) -> tuple[F32, F32]:
        """Depth and confidence (H, W) from the current poses of the frames ``used``."""
        o = self.options
        log_near, log_far = np.log(near * MEDIAN_DEPTH), np.log(far * MEDIAN_DEPTH)
        step = (log_far - log_near) / (o.shells - 1)
        depths = np.exp(log_near + step * np.arange(o.shells)).astype(np.float32)
        images, luma = self._images(used, scale), self.pyramids[0][scale.level]
        T = np.stack([self.T_fr[k] for k in used]).astype(np.float32)
        R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
        cost = np.empty((*scale.valid.shape, o.shells), np.float32)
        sweep_cost(luma, scale.rays, images, R, t, depths, self.code, scale.cam, np.float32(o.truncation), cost)
        cost = smooth_cost(cost, o.sigma_px, self.wrap)
        guide = np.nan_to_num(luma)
        total = semi_global(cost, guide, np.float32(o.p1), np.float32(o.p2), np.float32(o.edge), self.wrap)
        depth, confidence = np.empty(scale.valid.shape, np.float32), np.empty(scale.valid.shape, np.float32)
        pick_shell(total, log_near, step, depth, confidence)
        depth = _median(depth, self.wrap)
        information, out = np.empty_like(depth), np.empty_like(depth)
        depth_information(luma, depth, scale.rays, images, R, t, self.code, scale.cam, information)
        floor = o.planar_floor * float(np.median(information[scale.valid]))
        planar_filter(
            depth, np.where(scale.valid, information, 0).astype(np.float32), guide, scale.rays, o.planar_radius,
            o.planar_stride, o.planar_luma, o.planar_depth, floor, self.wrap, out,
        )  # fmt: skip
        return out, confidence

    def _images(self, used: NDArray[np.intp], scale: _Scale) -> F32:
        return np.stack([self.pyramids[k][scale.level] for k in used])

    def _bundle(self, used: NDArray[np.intp], depth: F32, scale: _Scale) -> None:
        """Poses of the frames ``used`` and depths together; the other frames follow at the next alignment."""
        T = np.stack([self.T_fr[k] for k in used])
        luma = self.pyramids[0][scale.level]
        T, _ = refine(luma, scale.rays, depth, self._images(used, scale), T, self.code, scale.cam)
        for k, pose in zip(used, T):
            self.T_fr[k] = pose


def _median(depth: F32, wrap: bool) -> F32:
    """5x5 median, across the seam of a panorama."""
    if not wrap:
        return np.asarray(cv2.medianBlur(depth, 5))
    wide = np.concatenate([depth[:, -4:], depth, depth[:, :4]], axis=1)
    return np.ascontiguousarray(cv2.medianBlur(wide, 5)[:, 4:-4])


def _resize(image: F32, shape: tuple[int, ...], wrap: bool) -> F32:
    """Bilinear resize to (H, W) with pixel centres at k + 0.5, across the seam of a panorama."""
    if image.shape == tuple(shape):
        return image.astype(np.float32)
    h, w = shape
    f = w // image.shape[1]
    if not wrap or w % image.shape[1]:
        return np.asarray(cv2.resize(image, (w, h), interpolation=cv2.INTER_LINEAR))
    wide = np.concatenate([image[:, -2:], image, image[:, :2]], axis=1)
    big = cv2.resize(wide, (wide.shape[1] * f, h), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(big[:, 2 * f : -2 * f])

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
    """width: working width. parallax_rad: translation over depth that ends the wait; frames: fewest and most used
    for the sweep; wait: most frames to wait for parallax. shells, near, far: sweep range over the median depth.
    """

    width: int = 256
    parallax_rad: float = 0.12
    parallax_fast_rad: float = 0.3
    min_frames: int = 4
    frames: int = 12
    wait: int = 60
    rounds: int = 3
    shells: int = 96
    near: float = 0.2
    far: float = 15.0
    sigma_px: float = 1.0
    truncation: float = 0.15
    p1: float = 0.001
    p2: float = 0.02
    edge: float = 20.0
    bundle: int = 1
    planar_passes: int = 1
    planar_radius: int = 12
    planar_stride: int = 2
    planar_luma: float = 0.05
    planar_depth: float = 0.03
    planar_floor: float = 0.01


MEDIAN_DEPTH = 2.0


class BootstrapDepth(DepthEstimator):
    """Buffers frames until they have parallax, then solves for depth and poses together."""

    def __init__(self, argument: str = "", options: BootstrapOptions = BootstrapOptions()) -> None:
        super().__init__(argument)
        self.options = options

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.full = camera
        self.camera = camera.scaled(self.options.width) if camera.width > self.options.width else camera
        self.valid = self.camera.valid_mask()
        self.code, self.cam = camera_code(self.camera)
        self.rays = np.nan_to_num(self.camera.rays()).astype(np.float32)
        self.align_options = AlignOptions(exposure=True)
        self.frames: list[Frame] = []
        self.pyramids: list[list[F32]] = []
        self.T_fr: list[NDArray[np.float64]] = []
        self.waited = 0

    # -- taking frames -------------------------------------------------------------------------------------------

    def add(self, frame: Frame) -> DepthEstimate | None:
        o = self.options
        self._append(frame)
        if len(self.frames) == 1:
            constant = np.where(self.valid, MEDIAN_DEPTH, np.nan).astype(np.float32)
            levels = self.pyramids[0]
            self.reference = make_reference(self.camera, levels[0], constant, len(levels), self.align_options)
            return None
        self._track_last()
        parallax = float(np.linalg.norm(self.T_fr[-1][:3, 3])) / MEDIAN_DEPTH
        n = len(self.frames)
        enough = (n >= o.frames and parallax >= o.parallax_rad) or (
            n >= o.min_frames and parallax >= o.parallax_fast_rad
        )
        if enough or n >= o.wait:
            return self._solve(parallax)
        return None

    def finish(self) -> DepthEstimate | None:
        if not self.frames:
            return None
        if len(self.frames) < 3:
            depth = np.full((self.full.height, self.full.width), MEDIAN_DEPTH, np.float32)
            return DepthEstimate(
                depth, self.frames[0].index, ok=False, message="bootstrap: too few frames; constant depth"
            )
        return self._solve(float(np.linalg.norm(self.T_fr[-1][:3, 3])) / MEDIAN_DEPTH)

    def _append(self, frame: Frame) -> None:
        image = frame.image
        if self.camera is not self.full:
            image = cv2.resize(image, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)
        self.frames.append(frame)
        self.pyramids.append(pyramid(luma_of_frame(image, self.valid)))
        self.T_fr.append(np.eye(4))

    def _predicted(self, k: int) -> NDArray[np.float64]:
        """Constant velocity from the two poses before frame k."""
        if k < 2:
            return self.T_fr[k - 1]
        return renormalise(self.T_fr[k - 1] @ invert_pose(self.T_fr[k - 2]) @ self.T_fr[k - 1])

    def _track_last(self) -> None:
        k = len(self.frames) - 1
        a = align(self.reference, self.pyramids[k], self._predicted(k), self.align_options)
        self.T_fr[k] = a.T_fr

    # -- solving -------------------------------------------------------------------------------------------------

    def _solve(self, parallax: float) -> DepthEstimate:
        o = self.options
        used = np.unique(np.linspace(1, len(self.frames) - 1, min(o.frames, len(self.frames) - 1)).round().astype(int))
        near, far = o.near, o.far
        confidence = np.zeros(self.valid.shape, np.float32)
        depth = np.full(self.valid.shape, MEDIAN_DEPTH, np.float32)
        for round_ in range(o.rounds):
            depth, confidence = self._sweep(used, near, far)
            scale = MEDIAN_DEPTH / float(np.median(depth[self.valid]))
            depth *= np.float32(scale)
            for T in self.T_fr:
                T[:3, 3] *= scale
            self._realign(depth)
            self._bundle(used, depth)
            if round_ >= 1:  # the coarse shape is known: spend the shells on the range that occurs
                low, high = np.percentile(depth[self.valid], [0.5, 99.5]) / MEDIAN_DEPTH
                near, far = max(0.7 * float(low), o.near), min(1.4 * float(high), o.far)
        return DepthEstimate(
            self._full_size(depth),
            self.frames[0].index,
            self._full_size(np.where(self.valid, confidence, 0)),
            {f.index: invert_pose(T) for f, T in zip(self.frames, self.T_fr)},
            message=f"bootstrap: {len(self.frames)} frames, parallax {np.rad2deg(parallax):.1f} deg",
        )

    def _sweep(self, used: NDArray[np.intp], near: float, far: float) -> tuple[F32, F32]:
        """Depth and confidence (H, W) from the current poses of the frames ``used``."""
        o = self.options
        log_near, log_far = np.log(near * MEDIAN_DEPTH), np.log(far * MEDIAN_DEPTH)
        step = (log_far - log_near) / (o.shells - 1)
        depths = np.exp(log_near + step * np.arange(o.shells)).astype(np.float32)
        images = np.stack([self.pyramids[k][0] for k in used])
        T = np.stack([self.T_fr[k] for k in used]).astype(np.float32)
        cost = np.empty((*self.valid.shape, o.shells), np.float32)
        R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
        luma = self.pyramids[0][0]
        sweep_cost(luma, self.rays, images, R, t, depths, self.code, self.cam, np.float32(o.truncation), cost)
        wrap = self.full.kind == "erp"
        cost = smooth_cost(cost, o.sigma_px, wrap)
        total = semi_global(cost, np.nan_to_num(luma), np.float32(o.p1), np.float32(o.p2), np.float32(o.edge), wrap)
        depth, confidence = np.empty(self.valid.shape, np.float32), np.empty(self.valid.shape, np.float32)
        pick_shell(total, log_near, step, depth, confidence)
        return self._planar(self._median(depth), images, R, t), confidence

    def _planar(self, depth: F32, images: F32, R: F32, t: F32) -> F32:
        """The depth under the prior that surfaces are piecewise planar."""
        o, luma = self.options, self.pyramids[0][0]
        out, information = np.empty_like(depth), np.empty_like(depth)
        for _ in range(o.planar_passes):
            depth_information(luma, depth, self.rays, images, R, t, self.code, self.cam, information)
            floor = o.planar_floor * float(np.median(information[self.valid]))
            weights = np.where(self.valid, information, 0).astype(np.float32)
            planar_filter(
                depth, weights, np.nan_to_num(luma), self.rays, o.planar_radius, o.planar_stride,
                o.planar_luma, o.planar_depth, floor, self.full.kind == "erp", out,
            )  # fmt: skip
            depth = out.copy()
        return depth

    def _median(self, depth: F32) -> F32:
        if self.full.kind != "erp":
            return np.asarray(cv2.medianBlur(depth, 5))
        wide = np.concatenate([depth[:, -4:], depth, depth[:, :4]], axis=1)
        return np.ascontiguousarray(cv2.medianBlur(wide, 5)[:, 4:-4])

    def _realign(self, depth: F32) -> None:
        levels = self.pyramids[0]
        masked = np.where(self.valid, depth, np.nan).astype(np.float32)
        self.reference = make_reference(self.camera, levels[0], masked, len(levels), self.align_options)
        for k in range(1, len(self.frames)):
            self.T_fr[k] = align(self.reference, self.pyramids[k], self.T_fr[k], self.align_options).T_fr

    def _bundle(self, used: NDArray[np.intp], depth: F32) -> None:
        """Poses of the frames ``used`` and depths together; the other frames follow at the next alignment."""
        if not self.options.bundle:
            return
        images = np.stack([self.pyramids[k][0] for k in used])
        T = np.stack([self.T_fr[k] for k in used])
        T, _ = refine(self.pyramids[0][0], self.rays, depth, images, T, self.code, self.cam)
        for k, pose in zip(used, T):
            self.T_fr[k] = pose

    def _full_size(self, image: F32) -> F32:
        """Up to the camera's size, across the seam."""
        if self.camera is self.full:
            return image.astype(np.float32)
        f = self.full.width // self.camera.width if self.full.width % self.camera.width == 0 else 0
        size = (self.full.width, self.full.height)
        if self.full.kind != "erp" or not f:
            return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_LINEAR))
        wide = np.concatenate([image[:, -2:], image, image[:, :2]], axis=1).astype(np.float32)
        big = cv2.resize(wide, (wide.shape[1] * f, self.full.height), interpolation=cv2.INTER_LINEAR)
        return np.ascontiguousarray(big[:, 2 * f : -2 * f])

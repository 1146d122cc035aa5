"""Depth of new regions by plane sweep over the frames that followed.

No earlier frame shows what a frame is the first to see: sweeping over earlier frames, or over both sides, is off by
tens of percent there. So the frame that receives depth lies some frames back, and only later frames are swept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.panogs.config import FixedLagOptions
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame
from panobench.photometric.pose_factors import log_scale
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama
from panobench.photometric.sweep import reprojection_error

#: Pixels over which errors are averaged before they are compared.
_ERROR_WINDOW = (5, 5)
#: Areas that are confirmed as a whole are this part of the image wide; so many of their pixels must be.
_AREA, _MAJORITY = 24, 0.5


@dataclass
class SweptDepth:
    """Depth and confidence (0..1) of a frame, (h, w) at the working size, and what it was swept from."""

    depth: F32
    confidence: F32
    target: BufferedFrame
    images: F32
    T_fr: NDArray[np.float64]

    def rescaled(self, T_fr: NDArray[np.float64]) -> SweptDepth:
        """With corrected poses (F, 4, 4): depths grow as the distances between the frames do."""
        grown = float(np.exp(-log_scale(T_fr, self.T_fr)))
        return replace(self, depth=np.asarray(self.depth * grown, np.float32), T_fr=T_fr)


class DepthSweep:
    """Sweeps, and judges the map's depth by the same frames."""

    def __init__(self, camera: Camera, scale: WorkingScale, options: FixedLagOptions) -> None:
        self.camera, self.scale, self.options = camera, scale, options

    def sweep(
        self, target: BufferedFrame, others: list[BufferedFrame], T_fr: NDArray[np.float64], scene_depth: float
    ) -> SweptDepth | None:
        """Radial depth of ``target`` in the unit of the poses, or None without enough parallax.

        T_fr (F, 4, 4): the others' poses from the target. scene_depth: the scene's median depth.
        """
        o = self.options
        if np.linalg.norm(T_fr[:, :3, 3], axis=1).max() < o.parallax_min * scene_depth:
            return None
        images = np.stack([f.luma for f in others])
        found, confidence = multi_view_depth(
            target.luma, self.scale, images, T_fr, o.near * scene_depth, o.far * scene_depth, SweepOptions()
        )
        return SweptDepth(found, confidence, target, images, T_fr)

    def full_size(self, swept: SweptDepth, among: NDArray[np.bool_] | None = None) -> F32:
        """Its depth (H, W) at the camera's size, NaN where it is unsure and better left to a later frame.

        among (h, w): pixels elsewhere are not sure.
        """
        sure = np.where(swept.confidence >= self.options.confidence, swept.depth, np.float32(np.nan))
        if among is not None:
            sure = np.where(among, sure, np.float32(np.nan))
        return resize_panorama(sure, (self.camera.height, self.camera.width), self.camera.kind == "erp")

    def map_over_swept(self, swept: SweptDepth, mapped: F32) -> float:
        """Median ratio of the map's depth (H, W) to the swept one; 1 where they share too little."""
        small = cv2.resize(mapped, self.scale.valid.shape[::-1], interpolation=cv2.INTER_NEAREST)
        ratio = (small / swept.depth)[np.isfinite(small) & self.scale.valid]
        return float(np.median(ratio)) if ratio.size > 0.05 * small.size else 1.0

    def disproved(self, swept: SweptDepth, mapped: F32) -> NDArray[np.bool_]:
        """(H, W): where another depth than ``mapped`` (H, W) explains the frames much better.

        Gaussians that spread over an opening can have the right colour at the wrong depth.
        """
        o, size = self.options, self.scale.valid.shape[::-1]
        small = cv2.resize(mapped, size, interpolation=cv2.INTER_NEAREST).astype(np.float32)
        with np.errstate(invalid="ignore"):
            other = np.abs(np.log(small / swept.depth)) > o.disprove_depth
            rivals = (np.where(other, depth, np.float32(np.nan)) for depth in (swept.depth, small))
            new, old = (self._error(swept, depth) for depth in rivals)
            better = new < o.disprove_share * old - o.disprove_margin
        full = cv2.resize((other & better).view(np.uint8), (self.camera.width, self.camera.height), interpolation=0)
        return np.asarray(full > 0)

    def confirmed(self, swept: SweptDepth, limit: float) -> NDArray[np.bool_]:
        """(h, w): where both halves of the frames show at the swept depth what the target shows.

        limit: of the mean difference (of 1) of images without their finest detail, which depends on where between the
        pixels it lies.
        """
        target = replace(swept.target, luma=_softened(swept.target.luma))
        soft = replace(swept, target=target, images=np.stack([_softened(image) for image in swept.images]))
        half = len(swept.images) // 2
        halves = (slice(None, half), slice(half, None)) if half else (slice(None),)
        errors = [self._error(replace(soft, images=soft.images[h], T_fr=soft.T_fr[h]), soft.depth) for h in halves]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.all([error < limit for error in errors], axis=0))

    def by_area(self, agreed: NDArray[np.bool_], doubted: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(H, W): areas in which the majority of the pixels that are ``doubted`` (H, W) are ``agreed`` on (h, w)."""
        small = cv2.resize(doubted.view(np.uint8), agreed.shape[::-1], interpolation=cv2.INTER_NEAREST)
        around, counts = (max(agreed.shape[1] // _AREA, 3),) * 2, small.astype(np.float32)
        most = cv2.blur(agreed * counts, around) > _MAJORITY * cv2.blur(counts, around)
        full = cv2.resize(most.view(np.uint8), (self.camera.width, self.camera.height), interpolation=0)
        return np.asarray(full > 0)

    def _error(self, swept: SweptDepth, depth: F32) -> F32:
        """Mean reprojection error around each pixel if its depth were ``depth`` (h, w), of those where it is known."""
        s, out = self.scale, np.empty(depth.shape, np.float32)
        T = swept.T_fr.astype(np.float32)
        R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
        truncation = np.float32(SweepOptions().truncation)
        reprojection_error(swept.target.luma, s.rays, swept.images, R, t, depth, s.code, s.cam, truncation, out)
        known = np.isfinite(out)
        total = cv2.blur(np.where(known, out, 0).astype(np.float32), _ERROR_WINDOW)
        count = cv2.blur(known.astype(np.float32), _ERROR_WINDOW)
        return np.where(count > 0, total / np.maximum(count, 1e-6), np.nan).astype(np.float32)


def _softened(luma: F32) -> F32:
    """Luma (h, w) without its finest detail; NaN stays NaN, and spreads by a pixel or two."""
    return np.asarray(cv2.GaussianBlur(luma, (5, 5), 1.0), dtype=np.float32)

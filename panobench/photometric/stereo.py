"""Multi-view stereo: the depth of one image from several with known poses.

A plane sweep, semi-global matching, a parabola through the least costs, a median filter and a piecewise-planar filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.planar import depth_information, planar_filter
from panobench.photometric.pyramid import F32, halve
from panobench.photometric.sweep import (
    padded,
    semi_global,
    smooth_cost,
    sweep_cost,
    temporal_selection,
    winner_takes_all,
)
from panobench.photometric.warp import camera_code


@dataclass(frozen=True)
class SweepOptions:
    """Options of ``multi_view_depth``. Luma is of 1.

    shells: number of depths tried, equally spaced in log depth. sigma_px: standard deviation of the aggregation in
    pixels. truncation: of the absolute difference in luma. p1, p2, edge: penalties of ``semi_global``. half_min:
    least number of frames in a half for ``temporal_selection``; half_ratio, half_margin: its thresholds. planar_*: of
    ``planar_filter``; planar_floor in units of the median information.
    """

    shells: int = 48
    sigma_px: float = 1.0
    truncation: float = 0.15
    p1: float = 0.001
    p2: float = 0.02
    edge: float = 20.0
    half_min: int = 2
    half_ratio: float = 0.6
    half_margin: float = 0.004
    planar_radius: int = 12
    planar_stride: int = 2
    planar_luma: float = 0.05
    planar_depth: float = 0.03
    planar_floor: float = 0.01


@dataclass(frozen=True)
class WorkingScale:
    """A width to work at, and what belongs to it.

    camera: scaled. rays (H, W, 3) float32: unit rays, 0 where a pixel has none. valid (H, W) bool. level: of the
    pyramid.
    """

    camera: Camera
    rays: F32
    valid: NDArray[np.bool_]
    level: int

    @property
    def code(self) -> int:
        """As from ``camera_code``."""
        return camera_code(self.camera)[0]

    @property
    def cam(self) -> F32:
        """As from ``camera_code``; of a rig it changes as the rig's size in the map's unit becomes known."""
        return camera_code(self.camera)[1]

    @classmethod
    def of(cls, camera: Camera, width: int) -> WorkingScale:
        """For the largest size of at most ``width`` columns that repeated halving of the camera's reaches."""
        level, size = 0, (camera.width, camera.height)
        while size[0] > width and size[0] % 2 == 0 and size[1] % 2 == 0:
            level, size = level + 1, (size[0] // 2, size[1] // 2)
        scaled = camera.scaled(camera.width >> level) if level else camera
        rays = np.nan_to_num(scaled.rays()).astype(np.float32)
        camera_code(scaled)  # refuses what cannot be aligned
        return cls(scaled, rays, scaled.valid_mask(), level)

    def halved(self, luma: F32) -> F32:
        """Luma of this camera at a larger size, halved until it is (H, W)."""
        while luma.shape[1] > self.valid.shape[1]:
            luma = halve(luma)
        return luma


def multi_view_depth(
    luma: F32,
    scale: WorkingScale,
    images: F32,
    T_fr: NDArray[np.float64],
    near: float,
    far: float,
    options: SweepOptions = SweepOptions(),
) -> tuple[F32, F32]:
    """Radial depth and confidence (0..1), both (H, W) float32, of the image ``luma`` (H, W), NaN where invalid.

    images (F, H, W): luma of other frames of the same camera, in temporal order. T_fr (F, 4, 4): their poses, frame
    from reference camera. near, far: the range swept, in the unit of the poses.
    """
    o, wrap = options, scale.camera.kind == "erp"
    step = (np.log(far) - np.log(near)) / (o.shells - 1)
    depths = np.exp(np.log(near) + step * np.arange(o.shells)).astype(np.float32)
    T = T_fr.astype(np.float32)
    R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])

    frames = padded(images, wrap)

    def costs(first: int, last: int) -> F32:
        out = np.empty((*scale.valid.shape, o.shells), np.float32)
        sweep_cost(
            luma, scale.rays, frames, R, t, depths, scale.code, scale.cam, np.float32(o.truncation), first, last, out
        )
        return out

    n, half = len(images), len(images) // 2
    if half >= o.half_min:
        early, late = costs(0, half), costs(half, n)
        early, late = (smooth_cost(c, o.sigma_px, wrap) for c in (early, late))
        cost = (early * np.float32(half / n)) + late * np.float32(1 - half / n)
        temporal_selection(cost, early, late, np.float32(o.half_ratio), np.float32(o.half_margin))
    else:
        cost = smooth_cost(costs(0, n), o.sigma_px, wrap)
    guide = np.nan_to_num(luma)
    total = semi_global(cost, guide, np.float32(o.p1), np.float32(o.p2), np.float32(o.edge), wrap)
    depth, confidence = np.empty(scale.valid.shape, np.float32), np.empty(scale.valid.shape, np.float32)
    winner_takes_all(total, np.log(near), step, depth, confidence)
    depth = _median(depth, wrap)
    information, out = np.empty_like(depth), np.empty_like(depth)
    depth_information(luma, depth, scale.rays, images, R, t, scale.code, scale.cam, information)
    floor = o.planar_floor * float(np.median(information[scale.valid]))
    weights = np.where(scale.valid, information, 0).astype(np.float32)
    planar_filter(
        depth, weights, guide, scale.rays, o.planar_radius, o.planar_stride, o.planar_luma, o.planar_depth,
        floor, wrap, out,
    )  # fmt: skip
    return out, confidence


def _median(depth: F32, wrap: bool) -> F32:
    """Median of 5 x 5 pixels of a depth map (H, W), across the seam of a panorama."""
    if not wrap:
        return np.asarray(cv2.medianBlur(depth, 5))
    wide = np.concatenate([depth[:, -4:], depth, depth[:, :4]], axis=1)
    return np.ascontiguousarray(cv2.medianBlur(wide, 5)[:, 4:-4])


def resize_panorama(image: F32, shape: tuple[int, ...], wrap: bool) -> F32:
    """Bilinear resize to ``shape`` (H, W) with pixel centres at k + 0.5, across the seam of a panorama (``wrap``)."""
    if image.shape == tuple(shape):
        return image.astype(np.float32)
    h, w = shape
    f = w // image.shape[1]
    if not wrap or w % image.shape[1]:
        return np.asarray(cv2.resize(image, (w, h), interpolation=cv2.INTER_LINEAR))
    wide = np.concatenate([image[:, -2:], image, image[:, :2]], axis=1)
    big = cv2.resize(wide, (wide.shape[1] * f, h), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(big[:, 2 * f : -2 * f])

"""Seeding by detail: dense where the image has edges, sparse where it is smooth.

Large discs draw a wall of one colour as well as small ones do, but not an edge. With the same number of Gaussians, the
image is sharper if smooth parts get fewer and detailed parts more.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.methods.splatting.seeding import equal_area_pixels
from panobench.splat.gaussians import F32

#: Gradient (of 1, per pixel at the equator) that noise alone may cause; smaller ones are no detail.
_NOISE = 0.006
#: Pixels over which detail is averaged, so that pixels near an edge are seeded like the edge.
_REACH = 2.0
#: One row and column in so many is enough to find the quantiles of detail.
_SPARSE = 3
_LATITUDE_COSINE_MIN = 0.3


@dataclass(frozen=True)
class DetailLevel:
    """share: of the image's solid angle, most detailed first; density: of its seeds, over the average wanted."""

    share: float
    density: float


#: Shares sum to 1, and share x density to 1.
LEVELS = (DetailLevel(0.25, 2.0), DetailLevel(0.30, 1.05), DetailLevel(0.45, 0.41))
EVEN = (DetailLevel(1.0, 1.0),)


class SeedPattern:
    """Seeds for the images of one camera; about ``count`` for a whole image."""

    def __init__(self, camera: Camera, count: int, levels: tuple[DetailLevel, ...] = LEVELS) -> None:
        self.camera, self.count, self.levels = camera, count, levels
        self.area = np.where(camera.valid_mask(), camera.solid_angle(), 0.0)
        self.spacing = float(np.sqrt(self.area.sum() / count))
        self.across = np.float32(1.0)
        self._made: dict[int, NDArray[np.float64]] = {}
        if camera.kind == "erp":
            cosine = np.hypot(camera.rays()[..., 0], camera.rays()[..., 2])
            self.across = (1.0 / np.maximum(cosine, _LATITUDE_COSINE_MIN)).astype(np.float32)

    def seeds(
        self, image: NDArray[np.uint8], wanted: NDArray[np.bool_] | None, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (M, 2) of an image (H, W, 3), only where ``wanted`` (H, W), and the angle (M,) to their neighbours."""
        level_of = self._level_of(image)
        pixels, spacing = [], []
        for number, level in enumerate(self.levels):
            here = (level_of == number) & (self.area > 0)
            if wanted is not None:
                here &= wanted
            if not here.any():
                continue
            p = self._lattice(number, rng)
            x, y = p[:, 0].astype(np.intp), p[:, 1].astype(np.intp)
            p = p[here[np.minimum(y, self.camera.height - 1), x % self.camera.width]]
            pixels.append(p)
            spacing.append(np.full(len(p), self.spacing / np.sqrt(level.density)))
        if not pixels:
            return np.empty((0, 2)), np.empty(0)
        return np.concatenate(pixels), np.concatenate(spacing)

    def _lattice(self, number: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Pixels as dense as the level wants them, never twice the same.

        Those of a panorama are made once and turned about the vertical: making them takes longer than inserting.
        """
        count = max(round(self.count * self.levels[number].density), 1)
        if self.camera.kind != "erp":
            return equal_area_pixels(self.camera, count, rng)
        if number not in self._made:
            around = round(count * 4 * np.pi / float(self.area.sum()))
            self._made[number] = equal_area_pixels(ErpCamera(self.camera.width, self.camera.height), around, rng)
        pixels = self._made[number].copy()
        pixels[:, 0] = (pixels[:, 0] + rng.uniform(0, self.camera.width)) % self.camera.width
        return pixels

    def _level_of(self, image: NDArray[np.uint8]) -> NDArray[np.intp]:
        """(H, W): number of the level each pixel belongs to."""
        last = len(self.levels) - 1
        if last == 0:
            return np.zeros(self.area.shape, np.intp)
        detail = self.detail(image)
        some, area = detail[::_SPARSE, ::_SPARSE].ravel(), self.area[::_SPARSE, ::_SPARSE].ravel()
        order = np.argsort(-some, kind="stable")
        covered = np.cumsum(area[order])
        shares = np.cumsum([level.share for level in self.levels[:-1]])
        least = some[order[np.minimum(np.searchsorted(covered, shares * covered[-1]), len(order) - 1)]]
        level = np.full(detail.shape, last, np.intp)
        for number in range(last - 1, -1, -1):
            level[detail > max(float(least[number]), _NOISE)] = number
        return level

    def detail(self, image: NDArray[np.uint8]) -> F32:
        """(H, W): root mean square gradient of the luma around each pixel, per pixel at the equator."""
        luma = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) / np.float32(255)
        mode, pad = cv2.BORDER_REPLICATE, 8
        if self.camera.kind == "erp":
            luma = np.concatenate([luma[:, -pad:], luma, luma[:, :pad]], axis=1)
        gx = cv2.Sobel(luma, cv2.CV_32F, 1, 0, ksize=3, scale=0.125, borderType=mode)
        gy = cv2.Sobel(luma, cv2.CV_32F, 0, 1, ksize=3, scale=0.125, borderType=mode)
        if self.camera.kind == "erp":
            gx, gy = gx[:, pad:-pad], gy[:, pad:-pad]
        energy = np.square(gx * self.across) + np.square(gy)
        return np.asarray(np.sqrt(cv2.GaussianBlur(energy, (0, 0), _REACH, borderType=mode)), dtype=np.float32)

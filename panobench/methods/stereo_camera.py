"""The camera in which depth is estimated: the method's own, or a panorama of what it sees.

Plane sweeps and alignment work on panoramas and undistorted pinhole images. Images of every other central camera are
reprojected to a panorama first.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.errors import UnsupportedError
from panobench.photometric.warp import camera_code
from panobench.types import Frame

#: Largest width of such a panorama, pixels.
WIDEST = 1024


class StereoCamera:
    """``camera`` is the camera for depth estimators; ``image`` and ``frame`` reproject to it."""

    def __init__(self, original: Camera) -> None:
        self.original = original
        self.camera, self._reprojector = original, None
        try:
            camera_code(original)
        except UnsupportedError:
            self._reprojector = _panorama_of(original)
            self.camera = self._reprojector.target.with_mask(self._reprojector.valid)

    _reprojector: Reprojector | None

    @property
    def is_original(self) -> bool:
        return self._reprojector is None

    def image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Image (H, W, 3) of the original camera -> image of ``camera``."""
        return image if self._reprojector is None else np.asarray(self._reprojector.image(image), np.uint8)

    def frame(self, frame: Frame) -> Frame:
        """The frame with its image, and its depth if there is one, as ``camera`` sees them."""
        if self._reprojector is None:
            return frame
        depth = None if frame.depth is None else self._reprojector.depth(frame.depth)
        return dataclasses.replace(frame, image=self.image(frame.image), depth=depth)

    def depth_along(self, depth: NDArray[np.float32], bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radial depth (N,) of ``camera``'s depth map (H, W) along bearings (N, 3); NaN where it has none."""
        pixels, seen = self.camera.project(bearings)
        h, w = depth.shape
        pixels = np.where(np.isfinite(pixels), pixels, 0.0)
        column = np.clip(np.floor(pixels[:, 0]).astype(int), 0, w - 1)
        row = np.clip(np.floor(pixels[:, 1]).astype(int), 0, h - 1)
        seen = seen & self.camera.valid_mask()[row, column]
        return np.where(seen, depth[row, column].astype(np.float64), np.nan)

    def depth_map(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """``camera``'s depth map -> one for the original's pixels; NaN where it has none."""
        if self._reprojector is None:
            return depth
        rays = self.original.rays()
        flat = self.depth_along(depth, np.nan_to_num(rays.reshape(-1, 3)))
        known = self.original.valid_mask()
        return np.where(known, flat.reshape(known.shape), np.nan).astype(np.float32)


def _panorama_of(camera: Camera) -> Reprojector:
    """To a panorama whose pixels are about as large as the camera's."""
    valid = camera.valid_mask()
    pixel = float(np.sqrt(np.median(camera.solid_angle()[valid])))
    width = min(64 * round(2 * np.pi / pixel / 64), WIDEST)
    width = max(width, 64)
    return Reprojector(camera, ErpCamera(width, width // 2))

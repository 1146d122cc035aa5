"""Rectification: frames as a global shutter with one centre of projection would have seen them.

While the rows of a frame are read, the camera rotates and travels: each row sees the scene from another pose. With a
known readout time and angular velocity the image can be rotated back row by row, and with depth and velocity what it
travelled can be undone, too. (Compare Forssen and Ringaby, "Rectifying rolling shutter video from
hand-held devices", CVPR 2010.) With depth, so can the parallax between two lenses that a panorama is stitched from.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from panobench.cameras.base import Camera
from panobench.cameras.row_times import rotated, row_times
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import resize_panorama

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
#: Displacements are worked out for one pixel in so many across and down (the first that divides the image), and
#: interpolated.
GRIDS_PX = (4, 2)
#: A pixel farther away than this has no part in a spline's value.
SPLINE_REACH = 12


def resampled(image: Image, at: F32, *, wrap: bool) -> Image:
    """The image (H, W, 3) at pixel indices ``at`` (H, W, 2), by cubic B-splines. wrap: columns go on at the other side.

    OpenCV's bicubic kernel moves what it interpolates by up to 0.05 pixels, and rounds positions to 1/32: more than
    tracking is off by.
    """
    if wrap:
        image = np.concatenate([image[:, -SPLINE_REACH:], image, image[:, :SPLINE_REACH]], axis=1)
        at = np.stack([np.mod(at[..., 0], image.shape[1] - 2 * SPLINE_REACH) + SPLINE_REACH, at[..., 1]], axis=-1)
    where = (at[..., 1], at[..., 0])
    out = np.empty((*at.shape[:2], image.shape[2]), dtype=np.uint8)
    for k in range(image.shape[2]):
        spline = ndimage.spline_filter(image[..., k], 3, output=np.float32, mode="nearest")
        values = ndimage.map_coordinates(spline, where, order=3, prefilter=False, mode="nearest")
        out[..., k] = np.clip(np.rint(values), 0, 255)
    return out


class Rectifier:
    """Resamples images by what ``shutter`` knows of row times and ``seam`` of the lenses."""

    def __init__(self, camera: Camera, shutter: RollingShutter, seam: Seam) -> None:
        self.camera, self.shutter, self.seam = camera, shutter, seam
        used = shutter.maybe or seam.stitched
        grid = next((g for g in GRIDS_PX if camera.width % (2 * g) == 0 and camera.height % g == 0), 1)
        self.coarse = camera.scaled(camera.width // grid) if used and grid > 1 else camera
        self.rays = np.nan_to_num(self.coarse.rays())
        v, u = np.indices((camera.height, camera.width), dtype=np.float32)
        self.pixels = np.stack([u, v], axis=-1)

    @property
    def enabled(self) -> bool:
        """Whether any image is changed."""
        return self.shutter.enabled or self.seam.lenses is not None

    def turned(self, image: Image, rate: Array) -> Image:
        """The image (H, W, 3) with its rows turned to the middle one's moment; ``rate`` (3,): rad/s, camera's axes."""
        if not self.shutter.differ(rate, np.zeros(3)):
            return image
        return self._moved(image, rate, np.zeros(3), np.zeros(self.rays.shape[:2]))

    def rectified(self, image: Image, rate: Array, velocity: Array, depth_map: F32) -> Image:
        """The image (H, W, 3) as a global shutter with one centre would have seen it at its middle row.

        rate (3,): rad/s. velocity (3,) a second, in the unit of the image's radial depth (H, W), which is NaN or 0
        where it is unknown: there only rotation is undone. Both in the camera's axes.
        """
        grid = self.camera.width // self.coarse.width
        coarse = depth_map[grid // 2 :: grid, grid // 2 :: grid].astype(np.float64)
        known = np.isfinite(coarse) & (coarse > 0)
        return self._moved(image, rate, velocity, np.where(known, 1.0 / np.where(known, coarse, 1.0), 0.0))

    def _moved(self, image: Image, rate: Array, velocity: Array, inverse_depth: Array) -> Image:
        """inverse_depth (h, w): on the coarse grid, 0 where it is unknown."""
        lenses, readout_s = self.seam.lenses, self.shutter.readout_s
        towards = velocity * inverse_depth[..., None]
        known = inverse_depth[..., None] > 0
        # A direction of the middle is seen by the row that sees it then: one step of fixed-point iteration finds it.
        seen = self.rays
        for _ in range(2 if readout_s else 1):
            at = readout_s * row_times(self.coarse, seen)
            seen = rotated(self.rays - towards * at[..., None], -at, rate)
            if lenses is not None:
                seen = np.where(known, lenses.stitched(seen, inverse_depth), seen)
        return resampled(image, self.pixels + self._shifts(seen), wrap=self.camera.kind == "erp")

    def _shifts(self, seen: Array) -> F32:
        """Displacement (H, W, 2) of each pixel, from the directions (h, w, 3) in which the coarse ones are seen."""
        panorama = self.camera.kind == "erp"
        h, w = seen.shape[:2]
        pixels, valid = self.coarse.project(seen.reshape(-1, 3))
        own, _ = self.coarse.project(self.rays.reshape(-1, 3))
        shift = np.where(valid[:, None], pixels - own, 0.0).reshape(h, w, 2)
        if panorama:
            shift[..., 0] = (shift[..., 0] + 0.5 * w) % w - 0.5 * w
        shift = (shift * (self.camera.width / w)).astype(np.float32)
        size = (self.camera.height, self.camera.width)
        return np.stack([resize_panorama(shift[..., k], size, panorama) for k in (0, 1)], axis=-1)

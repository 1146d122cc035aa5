"""The seam of a panorama stitched from two lenses: where these are in the map's unit, and where both are seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.two_lenses import BLEND, TwoLenses
from panobench.methods.panogs.config import StitchOptions
from panobench.photometric.pyramid import F32

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Seam:
    """lenses: None for one centre, or while the scale of the map is not known."""

    def __init__(self, camera: Camera, options: StitchOptions) -> None:
        self.options, self.baseline_m = options, 1e-3 * options.baseline_mm if camera.kind == "erp" else 0.0
        self.lenses: TwoLenses | None = None
        self.pixel = float(np.sqrt(np.median(camera.solid_angle()[camera.valid_mask()])))
        self._rays = camera.rays() if self.stitched else np.zeros((1, 1, 3))
        self._both = np.abs(self._rays[..., 2]) < np.sin(BLEND)

    @property
    def stitched(self) -> bool:
        """Whether the panoramas are said to come from two lenses."""
        return self.baseline_m > 0

    def place(self, metres: float, distance_m: float) -> None:
        """The lenses in the map's unit, which is so many metres; things at distance_m (0: infinity) are seamless."""
        self.lenses = TwoLenses(self.baseline_m / metres, metres / distance_m if distance_m > 0 else 0.0)

    def visible(self, depth_map: F32, mask: Mask | None) -> Mask | None:
        """``mask`` (H, W) without where both lenses are seen at once, plainly apart, at radial depths (H, W)."""
        if self.lenses is None or self.options.most_px == 0:
            return mask
        known = np.isfinite(depth_map) & (depth_map > 0)
        near = np.where(known, 1.0 / np.where(known, depth_map, 1.0), self.lenses.inverse_distance)
        apart = self._both & (self.lenses.parallax(self._rays, near) > self.options.most_px * self.pixel)
        return ~apart if mask is None else mask & ~apart

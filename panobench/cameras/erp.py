"""Equirectangular panorama.

lon = atan2(x, z), lat = atan2(-y, hypot(x, z)); u = W (1/2 + lon / 2 pi), v = H (1/2 - lat / pi).
Snyder, "Map Projections: a Working Manual" (USGS 1395, 1987), section 12 (plate carree).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, stack_jacobian
from panobench.cameras.seams import PanoramaSeams
from panobench.errors import CalibrationError
from panobench.geometry import directions_from_lonlat, lonlat_from_directions


@dataclass(frozen=True, eq=False)
class ErpCamera(ParametricCamera):
    """A 2:1 panorama on the full-sphere pixel grid.

    A limited field of view (``hfov_deg`` centred on the forward axis, latitudes ``lat_min_deg`` to ``lat_max_deg``)
    only makes the other pixels invalid: the image stays W x H, and every pixel keeps its ray.
    """

    kind = "erp"
    width_step = 2

    hfov_deg: float = 360.0
    lat_min_deg: float = -90.0
    lat_max_deg: float = 90.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width != 2 * self.height:
            if self.width == 2 * self.height + 1:  # as --width makes it
                raise CalibrationError(f"a panorama's width must be even, not {self.width}")
            raise CalibrationError(
                f"a panorama must be twice as wide as high, not {self.width}x{self.height}; "
                "data sets images and video read parts of the sphere and other layouts"
            )
        if not 0 < self.hfov_deg <= 360:
            raise CalibrationError(f"the horizontal field of view must be in (0, 360] degrees, not {self.hfov_deg:g}")
        if not -90 <= self.lat_min_deg < self.lat_max_deg <= 90:
            raise CalibrationError(
                f"latitudes must satisfy -90 <= min < max <= 90 degrees, not {self.lat_min_deg:g}..{self.lat_max_deg:g}"
            )

    def _in_view(self, lon: Array, lat: Array) -> NDArray[np.bool_]:
        ok = np.isfinite(lon) & np.isfinite(lat)
        if self.hfov_deg < 360:
            ok &= np.abs(lon) <= np.deg2rad(self.hfov_deg / 2)
        if self.lat_min_deg > -90:
            ok &= lat >= np.deg2rad(self.lat_min_deg)
        if self.lat_max_deg < 90:
            ok &= lat <= np.deg2rad(self.lat_max_deg)
        return np.asarray(ok)

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        points = np.asarray(points, dtype=np.float64)
        lon, lat = lonlat_from_directions(points)
        u = self.width * (0.5 + lon / (2 * np.pi))
        # The seam belongs to column 0 and the nadir to the last row, so that floor(u, v) is always a pixel.
        u = np.where(u >= self.width, 0.0, u)
        v = np.clip(self.height * (0.5 - lat / np.pi), 0.0, np.nextafter(self.height, 0.0))
        valid = self._in_view(lon, lat) & (points != 0).any(axis=-1)
        return np.stack([u, v], axis=-1), valid

    def unproject(self, pixels: ArrayLike) -> Array:
        """As ``Camera.unproject``; u wraps around, since any value is a longitude; NaN beyond the poles."""
        u, v = as_pixels(pixels)
        lon = (u / self.width - 0.5) * (2 * np.pi)
        lat = (0.5 - v / self.height) * np.pi
        rays = directions_from_lonlat(lon, lat)
        return np.where((np.isfinite(u) & (v >= 0) & (v <= self.height))[..., None], rays, np.nan)

    def jacobian(self, points: ArrayLike) -> Array:
        """As ``Camera.jacobian``; infinite on the polar axis, where the longitude is undefined."""
        x, y, z = as_points(points)
        h2 = x * x + z * z
        h, r2 = np.sqrt(h2), h2 + y * y
        with np.errstate(divide="ignore", invalid="ignore"):
            a = self.width / (2 * np.pi) / h2
            b = self.height / np.pi / r2
            return stack_jacobian((a * z, 0.0 * x, -a * x), (-b * x * y / h, b * h, -b * y * z / h))

    def valid_mask(self) -> NDArray[np.bool_]:
        lon = ((np.arange(self.width) + 0.5) / self.width - 0.5) * (2 * np.pi)
        lat = (0.5 - (np.arange(self.height) + 0.5) / self.height) * np.pi
        valid = self._in_view(lon[None, :], lat[:, None]) & np.ones((self.height, self.width), dtype=bool)
        return valid if self.mask is None else valid & self.mask

    def solid_angle(self) -> Array:
        """Exact: dlon (sin lat_top - sin lat_bottom) per row."""
        edges = np.sin((0.5 - np.arange(self.height + 1) / self.height) * np.pi)
        row = (edges[:-1] - edges[1:]) * (2 * np.pi / self.width)
        return np.where(self.valid_mask(), row[:, None], 0.0)

    def seams(self) -> PanoramaSeams:
        return PanoramaSeams(self.width, self.height)

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {}

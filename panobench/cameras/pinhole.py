"""Perspective camera with optional radial-tangential distortion.

x' = x / z, y' = y / z; (x'', y'') = distorted (see radtan.py) or the same; u = fx x'' + cx, v = fy y'' + cy.
Hartley & Zisserman, "Multiple View Geometry" (2004), chapter 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, stack_jacobian
from panobench.cameras.radtan import RadTan, check_coefficients
from panobench.errors import CalibrationError


@dataclass(frozen=True, eq=False)
class PinholeCamera(ParametricCamera):
    """Focal lengths and principal point in pixels (centre of the first pixel at 0.5, 0.5)."""

    kind = "pinhole"

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(f"focal lengths must be positive, not {self.fx:g}, {self.fy:g}")
        check_coefficients(self.distortion)

    @classmethod
    def from_fov(cls, width: int, hfov_deg: float, vfov_deg: float) -> PinholeCamera:
        """A camera of exactly ``hfov_deg`` x ``vfov_deg``, both below 180, and pixels as square as possible."""
        if not 0 < hfov_deg < 180 or not 0 < vfov_deg < 180:
            raise CalibrationError(
                f"a perspective view covers less than 180 degrees, not {hfov_deg:g}x{vfov_deg:g}; use erp or fisheye"
            )
        th, tv = np.tan(np.deg2rad(hfov_deg) / 2), np.tan(np.deg2rad(vfov_deg) / 2)
        height = max(1, round(width * tv / th))
        return cls(width, height, width / 2 / th, height / 2 / tv, width / 2, height / 2)

    @property
    def fov_deg(self) -> tuple[float, float]:
        """Horizontal and vertical field of view of the undistorted model, degrees."""
        h = np.arctan(self.cx / self.fx) + np.arctan((self.width - self.cx) / self.fx)
        v = np.arctan(self.cy / self.fy) + np.arctan((self.height - self.cy) / self.fy)
        return float(np.rad2deg(h)), float(np.rad2deg(v))

    @cached_property
    def _lens(self) -> RadTan | None:
        return RadTan(self.distortion) if any(self.distortion) else None

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            xn, yn = x / z, y / z
            valid = (z > 0) & np.isfinite(xn) & np.isfinite(yn)
            if self._lens:
                valid &= self._lens.invertible(xn, yn)
                xn, yn, _ = self._lens.distort(xn, yn)
            u, v = self.fx * xn + self.cx, self.fy * yn + self.cy
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        ok = np.isfinite(x) & np.isfinite(y)
        if self._lens:
            x, y, ok = self._lens.undistort(x, y)
        return normalised(np.stack([x, y, np.ones_like(x)], axis=-1), ok)

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            i = 1 / z
            xn, yn = x * i, y * i
            a, b, c, d = self._lens.distort(xn, yn)[2] if self._lens else (1.0, 0.0, 0.0, 1.0)
            du = (self.fx * a * i, self.fx * b * i, -self.fx * (a * xn + b * yn) * i)
            dv = (self.fy * c * i, self.fy * d * i, -self.fy * (c * xn + d * yn) * i)
            return stack_jacobian(du, dv)

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

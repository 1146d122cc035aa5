"""Mei's omnidirectional model: unit sphere, perspective from a point xi behind its centre, radial-tangential lens.

x' = x / (z + xi |p|), y' = y / (z + xi |p|); (x'', y'') = distorted (see radtan.py); u = fx x'' + cx, v = fy y'' + cy.
Mei & Rives, "Single view point omnidirectional camera calibration from planar grids" (ICRA 2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, quotient_jacobian
from panobench.cameras.radtan import RadTan, check_coefficients
from panobench.errors import CalibrationError


@dataclass(frozen=True, eq=False)
class MeiCamera(ParametricCamera):
    """xi >= 0; generalised focal lengths and centre in pixels; 0, 4, 5 or 8 distortion coefficients."""

    kind = "omni"

    fx: float
    fy: float
    cx: float
    cy: float
    xi: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(f"focal lengths must be positive, not {self.fx:g}, {self.fy:g}")
        if self.xi < 0:
            raise CalibrationError(f"omni camera: xi must not be negative, not {self.xi:g}")
        check_coefficients(self.distortion)

    @cached_property
    def _lens(self) -> RadTan | None:
        return RadTan(self.distortion) if any(self.distortion) else None

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            r = np.sqrt(x * x + y * y + z * z)
            n = z + self.xi * r
            xn, yn = x / n, y / n
            # For xi > 1 rays beyond the tangent cone would land on pixels that nearer ones have.
            valid = (n > 1e-9 * r) & (z > -r / max(self.xi, 1.0)) & (r > 0)
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
        r2 = x * x + y * y
        with np.errstate(invalid="ignore"):
            root = 1 + (1 - self.xi**2) * r2
            s = (self.xi + np.sqrt(root)) / (r2 + 1)
            return normalised(np.stack([s * x, s * y, s - self.xi], axis=-1), ok & (root > 0))

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        with np.errstate(invalid="ignore", divide="ignore"):
            r = np.sqrt(x * x + y * y + z * z)
            n = z + self.xi * r
            J = quotient_jacobian(1.0, 1.0, x, y, n, (self.xi * x / r, self.xi * y / r, 1 + self.xi * z / r))
            if self._lens:
                a, b, c, d = self._lens.distort(x / n, y / n)[2]
                J = np.stack([np.stack([a, b], axis=-1), np.stack([c, d], axis=-1)], axis=-2) @ J
            return np.asarray(J * np.array([self.fx, self.fy])[:, None])

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

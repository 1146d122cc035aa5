"""Double-sphere model.

d1 = |p|, k = xi d1 + z, d2 = sqrt(x^2 + y^2 + k^2), n = alpha d2 + (1 - alpha) k; u = fx x / n + cx, v = fy y / n + cy.
Usenko, Demmel, Cremers, "The Double Sphere Camera Model" (3DV 2018), equations 40-47.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, quotient_jacobian
from panobench.errors import CalibrationError


@dataclass(frozen=True, eq=False)
class DoubleSphereCamera(ParametricCamera):
    """xi in (-1, 1): distance between the spheres; alpha in [0, 1]: position of the image plane."""

    kind = "ds"

    fx: float
    fy: float
    cx: float
    cy: float
    xi: float
    alpha: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(f"focal lengths must be positive, not {self.fx:g}, {self.fy:g}")
        if not 0 <= self.alpha <= 1 or not -1 < self.xi < 1:
            raise CalibrationError(
                f"double sphere expects alpha in 0..1 and xi in -1..1, not {self.alpha:g} and {self.xi:g}"
            )

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        with np.errstate(invalid="ignore", divide="ignore"):
            d1 = np.sqrt(x * x + y * y + z * z)
            k = self.xi * d1 + z
            d2 = np.sqrt(x * x + y * y + k * k)
            n = self.alpha * d2 + (1 - self.alpha) * k
            u, v = self.fx * x / n + self.cx, self.fy * y / n + self.cy
            # The tight form of the paper's bound on z / d1 (w2), which is exact for xi = 0 only.
            w1 = min(self.alpha, 1 - self.alpha) / max(self.alpha, 1 - self.alpha)
            valid = (k > -w1 * d2) & (n > 1e-9 * d1) & (d1 > 0)
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        a, xi, r2 = self.alpha, self.xi, x * x + y * y
        with np.errstate(invalid="ignore", divide="ignore"):
            root = 1 - (2 * a - 1) * r2
            z = (1 - a * a * r2) / (a * np.sqrt(root) + 1 - a)
            inner = z * z + (1 - xi * xi) * r2
            s = (z * xi + np.sqrt(inner)) / (z * z + r2)
            rays = np.stack([s * x, s * y, s * z - xi], axis=-1)
            return normalised(rays, (root > 0) & (inner >= 0))

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        a, xi = self.alpha, self.xi
        with np.errstate(invalid="ignore", divide="ignore"):
            d1 = np.sqrt(x * x + y * y + z * z)
            k = xi * d1 + z
            d2 = np.sqrt(x * x + y * y + k * k)
            n = a * d2 + (1 - a) * k
            kx, ky, kz = xi * x / d1, xi * y / d1, xi * z / d1 + 1
            b = a * k / d2 + 1 - a
            nx, ny, nz = a * x / d2 + b * kx, a * y / d2 + b * ky, b * kz
            return quotient_jacobian(self.fx, self.fy, x, y, n, (nx, ny, nz))

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

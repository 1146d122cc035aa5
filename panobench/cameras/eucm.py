"""Enhanced unified camera model.

d = sqrt(beta (x^2 + y^2) + z^2), n = alpha d + (1 - alpha) z; u = fx x / n + cx, v = fy y / n + cy.
Khomutenko, Garcia, Martinet, "An Enhanced Unified Camera Model" (RA-L 2016). beta = 1 is the unified model.
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
class EucmCamera(ParametricCamera):
    """alpha in [0, 1], beta > 0; focal lengths and centre in pixels."""

    kind = "eucm"

    fx: float
    fy: float
    cx: float
    cy: float
    alpha: float
    beta: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(f"focal lengths must be positive, not {self.fx:g}, {self.fy:g}")
        if not 0 <= self.alpha <= 1 or self.beta <= 0:
            raise CalibrationError(f"eucm expects alpha in 0..1 and beta > 0, not {self.alpha:g} and {self.beta:g}")

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        a = self.alpha
        with np.errstate(invalid="ignore", divide="ignore"):
            d = np.sqrt(self.beta * (x * x + y * y) + z * z)
            n = a * d + (1 - a) * z
            u, v = self.fx * x / n + self.cx, self.fy * y / n + self.cy
            w = a / (1 - a) if a <= 0.5 else (1 - a) / a
            valid = (z > -w * d) & (n > 1e-9 * d) & (d > 0)
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        a, b, r2 = self.alpha, self.beta, x * x + y * y
        with np.errstate(invalid="ignore", divide="ignore"):
            root = 1 - (2 * a - 1) * b * r2
            z = (1 - b * a * a * r2) / (a * np.sqrt(root) + 1 - a)
            return normalised(np.stack([x, y, z], axis=-1), root > 0)

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        a, b = self.alpha, self.beta
        with np.errstate(invalid="ignore", divide="ignore"):
            d = np.sqrt(b * (x * x + y * y) + z * z)
            n = a * d + (1 - a) * z
            return quotient_jacobian(self.fx, self.fy, x, y, n, (a * b * x / d, a * b * y / d, a * z / d + 1 - a))

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

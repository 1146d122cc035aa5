"""Kannala-Brandt fisheye (OpenCV's fisheye, Kalibr's pinhole-equi, COLMAP's OPENCV_FISHEYE).

theta = atan2(hypot(x, y), z), d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),
u = fx d x / hypot(x, y) + cx, v = fy d y / hypot(x, y) + cy.
Kannala & Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses"
(PAMI 2006), radially symmetric part. With all k = 0 it is the equidistant lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, stack_jacobian
from panobench.cameras.radial import radial_partials
from panobench.errors import CalibrationError


@dataclass(frozen=True, eq=False)
class KannalaBrandtCamera(ParametricCamera):
    """Focal lengths and centre in pixels; four coefficients; ``fov_deg`` limits the cone that is valid."""

    kind = "fisheye"

    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    fov_deg: float = 360.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(f"focal lengths must be positive, not {self.fx:g}, {self.fy:g}")
        if len(self.k) != 4:
            raise CalibrationError(f"a fisheye has four coefficients k1 k2 k3 k4, not {len(self.k)}")
        if not 0 < self.fov_deg <= 360:
            raise CalibrationError(f"the field of view must be in (0, 360] degrees, not {self.fov_deg:g}")

    @classmethod
    def equidistant(cls, width: int, fov_deg: float) -> KannalaBrandtCamera:
        """A square image whose inscribed circle is the cone ``fov_deg`` wide, radius proportional to the angle."""
        if not 0 < fov_deg <= 360:
            raise CalibrationError(f"the field of view must be in (0, 360] degrees, not {fov_deg:g}")
        f = width / np.deg2rad(fov_deg)
        return cls(width, width, f, f, width / 2, width / 2, fov_deg=fov_deg)

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Angles as far as the model is one-to-one, and their radii."""
        theta = np.linspace(0.0, np.deg2rad(self.fov_deg / 2), 2049)
        stop = np.flatnonzero(self._slope(theta) <= 0)
        theta = theta[: max(int(stop[0]), 2)] if len(stop) else theta
        return theta, self._radius(theta)

    def _radius(self, theta: Array) -> Array:
        t2 = theta * theta
        k1, k2, k3, k4 = self.k
        return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))

    def _slope(self, theta: Array) -> Array:
        t2 = theta * theta
        k1, k2, k3, k4 = self.k
        return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        h = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            theta = np.arctan2(h, z)
            s = self._radius(theta) / np.where(h > 0, h, 1.0)
            u, v = self.fx * s * x + self.cx, self.fy * s * y + self.cy
            valid = (theta <= self._table[0][-1]) & (h * h + z * z > 0)
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        rho = np.hypot(x, y)
        angles, radii = self._table
        theta = np.interp(rho, radii, angles)
        for _ in range(3):
            theta = theta - (self._radius(theta) - rho) / self._slope(theta)
        s = np.sin(theta) / np.where(rho > 0, rho, 1.0)
        return normalised(np.stack([s * x, s * y, np.cos(theta)], axis=-1), rho <= radii[-1])

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        h = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            theta = np.arctan2(h, z)
            slope = self._slope(theta) / (h * h + z * z)
            _, dx, dy = radial_partials(x, y, self._radius(theta), slope * z, -slope * h, 1 / z)
            fx, fy = self.fx, self.fy
            return stack_jacobian((fx * dx[0], fx * dx[1], fx * dx[2]), (fy * dy[0], fy * dy[1], fy * dy[2]))

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

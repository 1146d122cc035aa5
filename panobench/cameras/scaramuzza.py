"""Scaramuzza's polynomial model (OCamCalib) for fisheye, catadioptric and panoramic annular lenses (PAL).

(u - cx, v - cy) = [c d; e 1] (x', y'), rho = hypot(x', y'), ray = (x', y', -f(rho)), f(rho) = p0 + p1 rho + ...
Camera frame: z along the optical axis, out of the lens; p0 < 0. The inverse polynomial gives rho from the elevation
theta = atan2(-z, hypot(x, y)): rho = q0 + q1 theta + ...; it is fitted, so projection solves the forward one instead.
Scaramuzza, Martinelli, Siegwart, "A toolbox for easily calibrating omnidirectional cameras" (IROS 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, stack_jacobian
from panobench.cameras.radial import radial_partials
from panobench.errors import CalibrationError


@dataclass(frozen=True, eq=False)
class ScaramuzzaCamera(ParametricCamera):
    """Polynomials in ascending powers; centre in pixels (first pixel's centre at 0.5).

    r_min, r_max: radii, in pixels before the affine part, between which the calibration holds: the image annulus of a
    panoramic annular lens. Where the polar angle no longer grows with the radius, nothing is valid.
    """

    kind = "pal"

    poly: tuple[float, ...]
    cx: float
    cy: float
    inv_poly: tuple[float, ...] = ()
    c: float = 1.0
    d: float = 0.0
    e: float = 0.0
    r_min: float = 0.0
    r_max: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= len(self.poly) <= 32 or len(self.inv_poly) > 64:
            raise CalibrationError(
                f"pal camera: 1 to 32 direct and at most 64 inverse coefficients are expected, "
                f"not {len(self.poly)} and {len(self.inv_poly)}"
            )
        if self.poly[0] >= 0:
            raise CalibrationError(f"pal camera: the constant term of poly must be negative, not {self.poly[0]:g}")
        if abs(self.c - self.d * self.e) < 1e-6:
            raise CalibrationError("pal camera: the affine matrix [c d; e 1] is singular")
        if self.r_min < 0 or (self.r_max is not None and self.r_max <= self.r_min):
            raise CalibrationError(f"pal camera: 0 <= r_min < r_max expected, not {self.r_min:g} and {self.r_max}")
        if self.reach <= self.r_min:
            raise CalibrationError(
                f"pal camera: the polar angle stops growing at r = {self.reach:.1f} px, "
                f"inside r_min = {self.r_min:g}; check the signs of poly"
            )

    @cached_property
    def _slope(self) -> Array:
        return np.asarray(polyder(np.array(self.poly)) if len(self.poly) > 1 else [0.0], dtype=np.float64)

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Increasing polar angles and their radii, within the image, r_max and the invertible part of the model."""
        u = np.array([0.0, self.width, 0.0, self.width]) - self.cx
        v = np.array([0.0, 0.0, self.height, self.height]) - self.cy
        reach = float(np.hypot(*self._straighten(u, v)).max())
        rho = np.linspace(0.0, reach if self.r_max is None else min(reach, self.r_max), 2049)
        growing = rho * polyval(rho, self._slope) - polyval(rho, self.poly) > 0  # d(polar angle)/d(rho)
        stop = np.flatnonzero(~growing)
        rho = rho[: max(int(stop[0]), 2)] if len(stop) else rho
        return self.polar_angle(rho), rho

    @property
    def reach(self) -> float:
        """Largest radius, pixels, at which a pixel still has a ray."""
        return float(self._table[1][-1])

    def _straighten(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Coordinates before the affine part."""
        k = 1 / (self.c - self.d * self.e)
        return k * (u - self.d * v), k * (self.c * v - self.e * u)

    def polar_angle(self, rho: ArrayLike) -> Array:
        """Angle from the optical axis, radians, at radius ``rho`` pixels."""
        rho = np.asarray(rho, dtype=np.float64)
        return np.asarray(np.arctan2(rho, -polyval(rho, self.poly)))

    def inverse_error(self, rho: ArrayLike) -> Array:
        """Radius by the inverse polynomial minus ``rho``, pixels, at the rays of the forward polynomial."""
        if not self.inv_poly:
            return np.zeros(np.shape(rho))
        rho = np.asarray(rho, dtype=np.float64)
        return np.asarray(polyval(np.arctan2(polyval(rho, self.poly), rho), self.inv_poly) - rho)

    def radius(self, h: Array, z: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Image radius of points at distance ``h`` from the axis and ``z`` along it, and whether the model holds.

        Newton's method on z rho + h f(rho) = 0, started from a table.
        """
        angles, radii = self._table
        angle = np.arctan2(h, z)
        rho = np.interp(angle, angles, radii)
        low = np.interp(self.r_min, radii, angles)
        valid = (angle >= low) & (angle <= angles[-1]) & (h * h + z * z > 0)
        for _ in range(3):
            slope = z + h * polyval(rho, self._slope)
            step = (z * rho + h * polyval(rho, self.poly)) / np.where(slope == 0, 1.0, slope)
            rho = np.where(valid, rho - step, rho)
        return rho, np.asarray(valid)

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        h = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            rho, valid = self.radius(h, z)
            s = np.where(h > 0, rho / np.where(h > 0, h, 1.0), 0.0)
            a, b = s * x, s * y
            u, v = self.c * a + self.d * b + self.cx, self.e * a + b + self.cy
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        x, y = self._straighten(u - self.cx, v - self.cy)
        rho = np.hypot(x, y)
        rays = np.stack([x, y, -polyval(rho, self.poly)], axis=-1)
        return normalised(rays, (rho >= self.r_min) & (rho <= self.reach))

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        h = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            rho, _ = self.radius(h, z)
            slope = z + h * polyval(rho, self._slope)
            _, dx, dy = radial_partials(x, y, rho, -polyval(rho, self.poly) / slope, -rho / slope, -self.poly[0] / z)
            du = tuple(self.c * p + self.d * q for p, q in zip(dx, dy))
            dv = tuple(self.e * p + q for p, q in zip(dx, dy))
            return stack_jacobian((du[0], du[1], du[2]), (dv[0], dv[1], dv[2]))

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        """As in ``ParametricCamera``. rho' = sy rho keeps the affine form [c d; e 1]; c and d absorb sx / sy."""
        ratio = sx / sy
        return {
            "cx": self.cx * sx,
            "cy": self.cy * sy,
            "c": self.c * ratio,
            "d": self.d * ratio,
            "poly": tuple(p * sy ** (1 - i) for i, p in enumerate(self.poly)),
            "inv_poly": tuple(q * sy for q in self.inv_poly),
            "r_min": self.r_min * sy,
            "r_max": None if self.r_max is None else self.r_max * sy,
        }

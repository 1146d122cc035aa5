"""Perspective camera with optional radial-tangential distortion.

x' = x/z, y' = y/z, r2 = x'^2 + y'^2, g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3);
x'' = x' g + 2 p1 x' y' + p2 (r2 + 2 x'^2), y'' = y' g + p1 (r2 + 2 y'^2) + 2 p2 x' y';
u = fx x'' + cx, v = fy y'' + cy.
Brown, "Close-range camera calibration" (1971); coefficient order k1 k2 p1 p2 [k3 [k4 k5 k6]] as OpenCV and Kalibr.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels, as_points, normalised, stack_jacobian
from panobench.errors import CalibrationError

#: Normalised image radius beyond which a distortion polynomial is not trusted (84 degrees off axis).
_MAX_RADIUS = 10.0


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
        if len(self.distortion) not in (0, 4, 5, 8):
            raise CalibrationError(
                f"radial-tangential distortion has 4, 5 or 8 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6]]), "
                f"not {len(self.distortion)}"
            )

    @classmethod
    def from_fov(cls, width: int, hfov_deg: float, vfov_deg: float) -> PinholeCamera:
        """Square pixels as nearly as whole rows allow; exactly ``hfov_deg`` x ``vfov_deg``, both below 180."""
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
    def _coefficients(self) -> tuple[float, ...]:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
        return k1, k2, p1, p2, k3, k4, k5, k6

    @cached_property
    def _max_r2(self) -> float:
        """Squared normalised radius up to which r g(r) grows, i.e. the distortion can be undone."""
        if not any(self.distortion):
            return np.inf
        r = np.linspace(0.0, _MAX_RADIUS, 4001)
        g, dg = self._radial(r * r)
        growing = (g > 0) & (g + 2 * r * r * dg > 0)
        stop = np.flatnonzero(~growing)
        return float(r[max(stop[0] - 1, 0)] ** 2) if len(stop) else _MAX_RADIUS**2

    def _radial(self, r2: Array) -> tuple[Array, Array]:
        """g and dg/dr2."""
        k1, k2, _, _, k3, k4, k5, k6 = self._coefficients
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            n = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            d = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
            dn = k1 + r2 * (2 * k2 + 3 * k3 * r2)
            dd = k4 + r2 * (2 * k5 + 3 * k6 * r2)
            return n / d, (dn * d - n * dd) / (d * d)

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array, tuple[Array, Array, Array, Array]]:
        """Distorted x, y and the partials (dx/dx, dx/dy, dy/dx, dy/dy)."""
        _, _, p1, p2 = self._coefficients[:4]
        r2 = x * x + y * y
        g, dg = self._radial(r2)
        xd = x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        xx = g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
        yy = g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x
        return xd, yd, (xx, xy, xy, yy)

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        x, y, z = as_points(points)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            xn, yn = x / z, y / z
            valid = (z > 0) & np.isfinite(xn) & np.isfinite(yn)
            if any(self.distortion):
                valid &= xn * xn + yn * yn <= self._max_r2
                xn, yn, (a, b, c, d) = self._distort(xn, yn)
                valid &= a * d - b * c > 0
            u, v = self.fx * xn + self.cx, self.fy * yn + self.cy
            return np.stack([u, v], axis=-1), np.asarray(valid & self._inside(u, v))

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        xd, yd = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        ok = np.isfinite(xd) & np.isfinite(yd)
        x, y = xd, yd
        if any(self.distortion):
            x, y, ok = self._undistort(xd, yd)
        return normalised(np.stack([x, y, np.ones_like(x)], axis=-1), ok)

    def _undistort(self, xd: Array, yd: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Newton's method on the distortion, steps kept inside the radius where it can be undone."""
        limit = np.sqrt(self._max_r2)
        x, y = xd.copy(), yd.copy()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for _ in range(50):
                r = np.hypot(x, y)
                shrink = np.where(r > limit, limit / r, 1.0)
                x, y = x * shrink, y * shrink
                xe, ye, (a, b, c, d) = self._distort(x, y)
                ex, ey = xd - xe, yd - ye
                det = a * d - b * c
                det = np.where(np.abs(det) < 1e-6, 1e-6, det)
                sx, sy = (d * ex - b * ey) / det, (a * ey - c * ex) / det
                x, y = x + sx, y + sy
                if not np.any(np.hypot(sx, sy) > 1e-14):
                    break
            xe, ye, (a, b, c, d) = self._distort(x, y)
            ok = (np.hypot(xd - xe, yd - ye) < 1e-10) & (x * x + y * y <= self._max_r2) & (a * d - b * c > 0)
        return x, y, np.asarray(ok)

    def jacobian(self, points: ArrayLike) -> Array:
        x, y, z = as_points(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            i = 1 / z
            xn, yn = x * i, y * i
            a, b, c, d = (1.0, 0.0, 0.0, 1.0) if not any(self.distortion) else self._distort(xn, yn)[2]
            du = (self.fx * a * i, self.fx * b * i, -self.fx * (a * xn + b * yn) * i)
            dv = (self.fy * c * i, self.fy * d * i, -self.fy * (c * xn + d * yn) * i)
            return stack_jacobian(du, dv)

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}

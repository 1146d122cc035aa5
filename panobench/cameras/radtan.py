"""Radial-tangential lens distortion in normalised coordinates.

r2 = x^2 + y^2, g = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3);
x' = x g + 2 p1 x y + p2 (r2 + 2 x^2), y' = y g + p1 (r2 + 2 y^2) + 2 p2 x y.
Brown, "Close-range camera calibration" (1971); coefficients in the order k1 k2 p1 p2 [k3 [k4 k5 k6]] of OpenCV.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Array
from panobench.errors import CalibrationError

#: Normalised radius beyond which no polynomial is used: 84 degrees from the optical axis.
_MAX_RADIUS = 10.0
#: dx'/dx, dx'/dy, dy'/dx, dy'/dy
Partials = tuple[Array, Array, Array, Array]


def check_coefficients(distortion: tuple[float, ...]) -> None:
    """Raises CalibrationError unless there are 0, 4, 5 or 8 coefficients."""
    if len(distortion) not in (0, 4, 5, 8):
        raise CalibrationError(
            "radial-tangential distortion has 4, 5 or 8 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6]]), "
            f"not {len(distortion)}"
        )


class RadTan:
    """The distortion, its derivative and its inverse."""

    def __init__(self, distortion: tuple[float, ...]) -> None:
        check_coefficients(distortion)
        self._k = (*distortion, *([0.0] * (8 - len(distortion))))
        self.max_r2 = self._find_max_r2()

    def _find_max_r2(self) -> float:
        """Squared radius up to which r g(r) grows, so that the radial part can be inverted."""
        r = np.linspace(0.0, _MAX_RADIUS, 4001)
        g, dg = self._radial(r * r)
        growing = (g > 0) & (g + 2 * r * r * dg > 0)
        stop = np.flatnonzero(~growing)
        return float(r[max(stop[0] - 1, 0)] ** 2) if len(stop) else _MAX_RADIUS**2

    def _radial(self, r2: Array) -> tuple[Array, Array]:
        """g and dg/dr2."""
        k1, k2, _, _, k3, k4, k5, k6 = self._k
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            n = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            d = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
            dn = k1 + r2 * (2 * k2 + 3 * k3 * r2)
            dd = k4 + r2 * (2 * k5 + 3 * k6 * r2)
            return n / d, (dn * d - n * dd) / (d * d)

    def distort(self, x: Array, y: Array) -> tuple[Array, Array, Partials]:
        """Distorted x', y' and their partial derivatives."""
        _, _, p1, p2 = self._k[:4]
        r2 = x * x + y * y
        g, dg = self._radial(r2)
        xd = x * g + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * g + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        xx = g + 2 * x * x * dg + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * dg + 2 * p1 * x + 2 * p2 * y
        yy = g + 2 * y * y * dg + 6 * p1 * y + 2 * p2 * x
        return xd, yd, (xx, xy, xy, yy)

    def invertible(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Whether undistorted x, y lies where the distortion is one-to-one."""
        a, b, c, d = self.distort(x, y)[2]
        return np.asarray((x * x + y * y <= self.max_r2) & (a * d - b * c > 0))

    def undistort(self, xd: Array, yd: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Undistorted x, y and whether there is a solution, by Newton's method inside the invertible radius."""
        limit = np.sqrt(self.max_r2)
        x, y = xd.copy(), yd.copy()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for _ in range(50):
                r = np.hypot(x, y)
                shrink = np.where(r > limit, limit / r, 1.0)
                x, y = x * shrink, y * shrink
                xe, ye, (a, b, c, d) = self.distort(x, y)
                ex, ey = xd - xe, yd - ye
                det = a * d - b * c
                det = np.where(np.abs(det) < 1e-6, 1e-6, det)
                sx, sy = (d * ex - b * ey) / det, (a * ey - c * ex) / det
                x, y = x + sx, y + sy
                if not np.any(np.hypot(sx, sy) > 1e-14):
                    break
            xe, ye, _ = self.distort(x, y)
            ok = (np.hypot(xd - xe, yd - ye) < 1e-10) & self.invertible(x, y)
        return x, y, np.asarray(ok)

"""Cubemap: six 90 degree perspective faces side by side, front right back left up down.

Within a face of n pixels: u = n/2 (1 + x/z), v = n/2 (1 + y/z) in the face's axes, which are those of the named views
(views.py): the bottom of `up` and the top of `down` touch the top and the bottom of `front`.
Greene, "Environment mapping and other applications of world projections" (CG&A 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array
from panobench.cameras.parametric import ParametricCamera, as_pixels
from panobench.cameras.seams import CubemapSeams
from panobench.cameras.views import view_rotation
from panobench.errors import CalibrationError

FACES = ("front", "right", "back", "left", "up", "down")


@dataclass(frozen=True, eq=False)
class CubemapCamera(ParametricCamera):
    """A strip 6 n wide and n high. Faces that touch in the strip need not be neighbours on the cube."""

    kind = "cubemap"
    width_step = 6

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width != 6 * self.height:
            raise CalibrationError(
                f"a cubemap is a strip of six square faces, six times as wide as high, not {self.width}x{self.height}"
            )

    @cached_property
    def rotations(self) -> Array:
        """(6, 3, 3): from camera axes to each face's axes."""
        return np.stack([view_rotation(name) for name in FACES])

    def _face_points(self, points: Array) -> tuple[NDArray[np.intp], Array]:
        """The face each point (..., 3) falls on, and the point in that face's axes."""
        with np.errstate(invalid="ignore"):
            face = np.argmax(np.nan_to_num(points @ self.rotations[:, 2].T, nan=-np.inf), axis=-1)
            return face, np.asarray((self.rotations[face] @ points[..., None])[..., 0])

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        p = np.asarray(points, dtype=np.float64)
        n = self.height
        face, q = self._face_points(p)
        with np.errstate(invalid="ignore", divide="ignore"):
            inside = np.nextafter(n, 0)  # an edge belongs to the chosen face, not to the next one in the strip
            a = np.clip(n / 2 * (1 + q[..., 0] / q[..., 2]), 0, inside)
            b = np.clip(n / 2 * (1 + q[..., 1] / q[..., 2]), 0, inside)
        valid = np.isfinite(p).all(axis=-1) & (p != 0).any(axis=-1)
        return np.stack([np.minimum(face * n + a, np.nextafter((face + 1.0) * n, 0)), b], axis=-1), valid

    def unproject(self, pixels: ArrayLike) -> Array:
        u, v = as_pixels(pixels)
        with np.errstate(invalid="ignore"):
            # The strip's right border belongs to the last face, and NaN needs some index.
            face = np.clip(np.nan_to_num(u // self.height), 0, 5).astype(np.intp)
        return self.unproject_face(u, v, face)

    def unproject_face(self, u: Array, v: Array, face: NDArray[np.intp]) -> Array:
        """Rays of pixels on given faces; the right border of a face has the pixel coordinate of the next one."""
        n = self.height
        a, b = 2 * (u - face * n) / n - 1, 2 * v / n - 1
        ok = (a >= -1) & (a <= 1) & (b >= -1) & (b <= 1)
        q = np.stack([a, b, np.ones_like(a)], axis=-1)
        rays = (np.swapaxes(self.rotations, 1, 2)[face] @ q[..., None])[..., 0]
        return np.where(ok[..., None], rays / np.linalg.norm(q, axis=-1, keepdims=True), np.nan)

    def jacobian(self, points: ArrayLike) -> Array:
        p = np.asarray(points, dtype=np.float64)
        face, q = self._face_points(p)
        with np.errstate(invalid="ignore", divide="ignore"):
            i = 1 / q[..., 2]
            zero = np.zeros_like(i)
            du = np.stack([i, zero, -q[..., 0] * i * i], axis=-1)
            dv = np.stack([zero, i, -q[..., 1] * i * i], axis=-1)
            return np.asarray(self.height / 2 * np.stack([du, dv], axis=-2) @ self.rotations[face])

    def solid_angle(self) -> Array:
        """As ``Camera.solid_angle``, exact: the integral of (1 + a^2 + b^2)^(-3/2) over the pixel."""
        edge = np.linspace(-1.0, 1.0, self.height + 1)
        a, b = edge[None, :], edge[:, None]
        corner = np.arctan2(a * b, np.sqrt(1 + a * a + b * b))
        one = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
        return np.where(self.valid_mask(), np.tile(one, (1, 6)), 0.0)

    def seams(self) -> CubemapSeams:
        return CubemapSeams(self)

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        return {}

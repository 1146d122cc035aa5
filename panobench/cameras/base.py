"""The camera contract. Every model projects and unprojects, and round-trips to 1e-6 px where valid.

Pixel centres are at k + 0.5. Camera frame: x right, y down, z forward.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from panobench.cameras.seams import Seams

Array = NDArray[np.float64]


class Camera(ABC):
    """A central camera of ``width`` x ``height`` pixels. Immutable.

    mask: (H, W) False for pixels that the lens or the rig hides, besides the model's own limits; None: all are good.
    """

    kind: ClassVar[str]
    #: ``scaled`` takes multiples of this width.
    width_step: ClassVar[int] = 1
    width: int
    height: int
    mask: NDArray[np.bool_] | None = None

    @abstractmethod
    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Project points (..., 3) in the camera frame to pixels (..., 2), (u, v), and whether they are valid (...,).

        A valid point is inside the image and the model's domain. The pixels of other points are undefined.
        """

    @abstractmethod
    def unproject(self, pixels: ArrayLike) -> Array:
        """Unit rays (..., 3) of pixels (..., 2); NaN where the model has no ray."""

    @abstractmethod
    def jacobian(self, points: ArrayLike) -> Array:
        """Derivative d(u, v) / d(point), (..., 2, 3), at points (..., 3)."""

    @abstractmethod
    def scaled(self, width: int) -> Camera:
        """The same view at another width; the height keeps the aspect ratio, and the mask is resized too."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain values for camera.yaml, without the mask: {"model": kind, "width": ..., "height": ..., ...}."""

    @classmethod
    @abstractmethod
    def from_dict(cls, values: dict[str, Any]) -> Camera:
        """Inverse of ``to_dict``. Raises CalibrationError for missing, unknown or impossible values."""

    @abstractmethod
    def with_mask(self, mask: NDArray[np.bool_] | None) -> Camera:
        """A copy with another mask (H, W)."""

    def seams(self) -> Seams:
        """How interpolation continues across the image's borders; by default it does not."""
        from panobench.cameras.seams import Seams

        return Seams(self.width, self.height)

    def pixel_grid(self) -> Array:
        """(H, W, 2) centres of all pixels."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    @cached_property
    def _rays(self) -> Array:
        return self.unproject(self.pixel_grid())

    def rays(self) -> Array:
        """Unit rays (H, W, 3) of all pixel centres; NaN where the model has none. Cached: do not change it."""
        return self._rays

    def valid_mask(self) -> NDArray[np.bool_]:
        """(H, W) whether a pixel has a ray, lies in the model's field of view and is not masked."""
        valid = np.isfinite(self.rays()).all(axis=-1)
        return np.asarray(valid if self.mask is None else valid & self.mask)

    def solid_angle(self) -> Array:
        """(H, W) solid angle of each pixel, steradians; 0 where it has no ray.

        By default it is the area of two spherical triangles between the rays of the pixel's corners (Van Oosterom &
        Strackee 1983). At the rim, where a corner has no ray, it is 1 / |dr_u x dr_v| from the Jacobian.
        """
        u, v = np.meshgrid(np.arange(self.width + 1.0), np.arange(self.height + 1.0))
        r = self.unproject(np.stack([u, v], axis=-1))
        a, b, c, d = r[:-1, :-1], r[:-1, 1:], r[1:, 1:], r[1:, :-1]
        area = spherical_triangle_area(a, b, c) + spherical_triangle_area(a, c, d)
        valid = self.valid_mask()
        rim = valid & ~np.isfinite(area)
        if rim.any():
            J = self.jacobian(self.rays()[rim])
            area[rim] = 1 / np.linalg.norm(np.cross(J[:, 0], J[:, 1]), axis=-1)
        return np.where(valid, area, 0.0)


def spherical_triangle_area(a: Array, b: Array, c: Array) -> Array:
    """Solid angle of the triangle between unit vectors (..., 3) (Van Oosterom & Strackee 1983)."""
    triple = np.abs(np.sum(a * np.cross(b, c), axis=-1))
    denom = 1 + np.sum(a * b, axis=-1) + np.sum(b * c, axis=-1) + np.sum(c * a, axis=-1)
    return np.asarray(2 * np.arctan2(triple, denom))

"""The camera contract. Every model projects, unprojects and round-trips to 1e-6 px where valid.

Pixel centres are at k + 0.5; camera frame x right, y down, z forward.
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

    ``mask`` (H, W) bool or None excludes pixels the lens or rig hides, on top of the model's own limits.
    """

    kind: ClassVar[str]
    #: Widths that ``scaled`` takes are multiples of this.
    width_step: ClassVar[int] = 1
    width: int
    height: int
    mask: NDArray[np.bool_] | None = None

    @abstractmethod
    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Points (..., 3) in the camera frame -> pixels (..., 2) as (u, v) and valid (...,).

        Valid means: inside the image and inside the model's domain. Pixels of invalid points may be anything.
        """

    @abstractmethod
    def unproject(self, pixels: ArrayLike) -> Array:
        """Pixels (..., 2) -> unit rays (..., 3); NaN where the model has no ray."""

    @abstractmethod
    def jacobian(self, points: ArrayLike) -> Array:
        """d(u, v) / d(point), (..., 2, 3), at points (..., 3)."""

    @abstractmethod
    def scaled(self, width: int) -> Camera:
        """The same view at another width (height follows the aspect ratio); the mask is resized too."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain values for camera.yaml: {"model": kind, "width": ..., "height": ..., ...} (mask not included)."""

    @classmethod
    @abstractmethod
    def from_dict(cls, values: dict[str, Any]) -> Camera:
        """Inverse of ``to_dict``. Raises CalibrationError for missing, unknown or impossible values."""

    @abstractmethod
    def with_mask(self, mask: NDArray[np.bool_] | None) -> Camera:
        """A copy with another mask (H, W)."""

    def seams(self) -> Seams:
        """What lies beyond the image's borders, for interpolation; by default nothing."""
        from panobench.cameras.seams import Seams

        return Seams(self.width, self.height)

    def pixel_grid(self) -> Array:
        """Centres of all pixels, (H, W, 2)."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    @cached_property
    def _rays(self) -> Array:
        return self.unproject(self.pixel_grid())

    def rays(self) -> Array:
        """Unit rays of all pixel centres (H, W, 3); NaN where the model has none. Cached: do not write into it."""
        return self._rays

    def valid_mask(self) -> NDArray[np.bool_]:
        """(H, W): the pixel has a ray, lies in the model's field of view and is not masked."""
        valid = np.isfinite(self.rays()).all(axis=-1)
        return np.asarray(valid if self.mask is None else valid & self.mask)

    def solid_angle(self) -> Array:
        """(H, W) steradians covered by each pixel (0 where it has no ray); sums to the coverage.

        Default: area of the two spherical triangles between the rays of the pixel's corners
        (Van Oosterom & Strackee 1983); at the rim, where a corner has no ray, 1 / |dr_u x dr_v| from the Jacobian.
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

"""A camera model that no real lens has, complete by the contract: a fisheye whose radius is f tan(angle / 4)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Camera
from panobench.errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FakeCamera(Camera):
    """r = f tan(theta / 4) about the image's middle, up to ``max_angle`` radians from the axis."""

    kind: ClassVar[str] = "fake"
    width: int = 64
    height: int = 48
    f: float = 40.0
    max_angle: float = 1.9
    mask: NDArray[np.bool_] | None = field(default=None, repr=False)

    @classmethod
    def example(cls, width: int = 64) -> FakeCamera:
        return cls().scaled(width)

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        p = np.asarray(points, dtype=np.float64)
        rho = np.hypot(p[..., 0], p[..., 1])
        theta = np.arctan2(rho, p[..., 2])
        small = rho < 1e-12
        with np.errstate(invalid="ignore"):
            scale = np.where(small, self.f / 4, self.f * np.tan(theta / 4) / np.where(small, 1.0, rho))
            uv = p[..., :2] * scale[..., None] + np.array([self.width / 2, self.height / 2])
            inside = (uv >= 0).all(axis=-1) & (uv[..., 0] <= self.width) & (uv[..., 1] <= self.height)
            valid = inside & (theta <= self.max_angle) & (np.linalg.norm(p, axis=-1) > 0)
        return uv, valid & ~(small & (p[..., 2] <= 0))

    def unproject(self, pixels: ArrayLike) -> Array:
        uv = np.asarray(pixels, dtype=np.float64) - np.array([self.width / 2, self.height / 2])
        r = np.hypot(uv[..., 0], uv[..., 1])
        theta = 4 * np.arctan(r / self.f)
        k = np.where(r < 1e-12, 4 / self.f, np.sin(theta) / np.where(r < 1e-12, 1.0, r))
        rays = np.stack([uv[..., 0] * k, uv[..., 1] * k, np.cos(theta)], axis=-1)
        rays[theta > self.max_angle] = np.nan
        return rays

    def jacobian(self, points: ArrayLike) -> Array:
        """As ``Camera.jacobian``, by central differences."""
        p = np.asarray(points, dtype=np.float64)
        columns = []
        for axis in range(3):
            h = np.zeros(3)
            h[axis] = 1e-6
            columns.append((self.project(p + h)[0] - self.project(p - h)[0]) / 2e-6)
        return np.stack(columns, axis=-1)

    def scaled(self, width: int) -> FakeCamera:
        s = width / self.width
        height = max(1, round(self.height * s))
        mask = None
        if self.mask is not None:
            rows = np.minimum((np.arange(height) + 0.5) / s, self.height - 1).astype(int)
            cols = np.minimum((np.arange(width) + 0.5) / s, self.width - 1).astype(int)
            mask = self.mask[np.ix_(rows, cols)]
        return replace(self, width=width, height=height, f=self.f * s, mask=mask)

    def to_dict(self) -> dict[str, Any]:
        return {"model": self.kind, **{k: getattr(self, k) for k in ("width", "height", "f", "max_angle")}}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> FakeCamera:
        expected = {"model", "width", "height", "f", "max_angle"}
        if set(values) != expected:
            raise CalibrationError(f"a fake camera has exactly the keys {sorted(expected)}, got {sorted(values)}")
        try:
            camera = cls(int(values["width"]), int(values["height"]), float(values["f"]), float(values["max_angle"]))
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"a fake camera's values are numbers: {error}") from error
        numbers = (camera.width, camera.height, camera.f, camera.max_angle)
        if not (np.isfinite(numbers).all() and min(numbers) > 0 and camera.max_angle < np.pi):
            raise CalibrationError("a fake camera's values are positive, its max_angle below pi")
        return camera

    def with_mask(self, mask: NDArray[np.bool_] | None) -> FakeCamera:
        if mask is not None and mask.shape != (self.height, self.width):
            raise CalibrationError(f"the mask is {mask.shape}, the image ({self.height}, {self.width})")
        return replace(self, mask=mask)


def pinhole_camera(width: int = 64, horizontal_deg: float = 90.0, vertical_deg: float = 70.0) -> Camera:
    """An undistorted pinhole camera of a given field of view."""
    from panobench.cameras.pinhole import PinholeCamera

    return PinholeCamera.from_fov(width, horizontal_deg, vertical_deg)


def fisheye_camera(width: int = 96, fov_deg: float = 120.0) -> Camera:
    """A square equidistant fisheye camera (Kannala-Brandt without distortion)."""
    from panobench.cameras.kannala_brandt import KannalaBrandtCamera

    return KannalaBrandtCamera.equidistant(width, fov_deg)


def annular_camera() -> Camera:
    """A panoramic annular lens like PALVIO's at a tenth of its size (128x96): 40 to 110 degrees off the axis."""
    from panobench.cameras.scaramuzza import ScaramuzzaCamera

    direct = (-24.45, 0.0, 0.0174861, -0.000175777, 0.00004475965)
    return ScaramuzzaCamera(128, 96, direct, 64.5, 48.6, (37.7, 24.7, 1.9, 2.4), r_min=16, r_max=47)

"""Rolling shutter: frames are rectified to the moment of their middle row before anything else sees them.

While the rows of a frame are read, the camera rotates: each row sees the scene from another orientation. With a known
readout time and angular velocity the image can be rotated back row by row. What the camera travels meanwhile is left
out; at walking speed that is a few millimetres. (Compare Forssen and Ringaby, "Rectifying rolling shutter video from
hand-held devices", CVPR 2010.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from panobench.cameras.base import Camera
from panobench.cameras.row_times import row_times
from panobench.geometry import so3_log
from panobench.methods.panogs.config import RollingShutterOptions
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import resize_panorama

Pose = NDArray[np.float64]
Image = NDArray[np.uint8]
#: Displacements are worked out for one pixel in so many across and down (the first that divides the image), and
#: interpolated.
GRIDS_PX = (4, 2)
#: A pixel farther away than this has no part in a spline's value.
SPLINE_REACH = 12


def resampled(image: Image, at: F32, *, wrap: bool) -> Image:
    """The image (H, W, 3) at pixel indices ``at`` (H, W, 2), by cubic B-splines. wrap: columns go on at the other side.

    OpenCV's bicubic kernel moves what it interpolates by up to 0.05 pixels, and rounds positions to 1/32: more than
    tracking is off by.
    """
    if wrap:
        image = np.concatenate([image[:, -SPLINE_REACH:], image, image[:, :SPLINE_REACH]], axis=1)
        at = np.stack([np.mod(at[..., 0], image.shape[1] - 2 * SPLINE_REACH) + SPLINE_REACH, at[..., 1]], axis=-1)
    where = (at[..., 1], at[..., 0])
    out = np.empty((*at.shape[:2], image.shape[2]), dtype=np.uint8)
    for k in range(image.shape[2]):
        spline = ndimage.spline_filter(image[..., k], 3, output=np.float32, mode="nearest")
        values = ndimage.map_coordinates(spline, where, order=3, prefilter=False, mode="nearest")
        out[..., k] = np.clip(np.rint(values), 0, 255)
    return out


class RollingShutter:
    """Knows the camera's row times and how fast it rotated at the last frames."""

    def __init__(self, camera: Camera, options: RollingShutterOptions) -> None:
        self.camera, self.readout_s = camera, 1e-3 * options.readout_ms
        self.least = options.least_px * float(np.sqrt(np.median(camera.solid_angle()[camera.valid_mask()])))
        grid = next((g for g in GRIDS_PX if camera.width % (2 * g) == 0 and camera.height % g == 0), 1)
        self.coarse = camera.scaled(camera.width // grid) if self.enabled and grid > 1 else camera
        self.rays = np.nan_to_num(self.coarse.rays())
        self.rows = row_times(self.coarse, self.rays) if self.enabled else None
        v, u = np.indices((camera.height, camera.width), dtype=np.float32)
        self.pixels = np.stack([u, v], axis=-1)
        self._last: tuple[float, Pose] | None = None  # time and R_wc (3, 3) of the last frame
        self._rates: list[Pose] = []  # between the last frames, rad/s in the camera's axes

    @property
    def enabled(self) -> bool:
        return self.readout_s > 0

    def predicted_rate(self) -> Pose:
        """Angular velocity (3,) at the next frame, rad/s in the camera's axes, from the rates between the last frames.

        A rate between two frames is that of their middle, so the next frame is one and a half intervals later.
        """
        if not self._rates:
            return np.zeros(3)
        if len(self._rates) == 1:
            return self._rates[-1]
        return self._rates[-1] + 1.5 * (self._rates[-1] - self._rates[-2])

    def measured_rate(self, time: float, T_wc: Pose) -> Pose:
        """Angular velocity (3,) at a frame that has just been tracked at ``T_wc`` (4, 4)."""
        if self._last is None:
            return np.zeros(3)
        newest = self._between(time, T_wc)
        return newest + 0.5 * (newest - self._rates[-1]) if self._rates else newest

    def record(self, time: float, T_wc: Pose) -> None:
        """A frame's final pose (4, 4)."""
        if self._last is not None:
            self._rates = [*self._rates[-1:], self._between(time, T_wc)]
        self._last = (time, T_wc[:3, :3])

    def forget(self) -> None:
        """The next frame does not follow the last one."""
        self._last, self._rates = None, []

    def differ(self, rate: Pose, other: Pose) -> bool:
        """Whether two angular velocities (3,) rectify pixels to plainly different places."""
        return float(np.linalg.norm(rate - other)) * 0.5 * self.readout_s > self.least

    def rectified(self, image: Image, rate: Pose) -> Image:
        """The image (H, W, 3) as a global shutter would have seen it at its middle row. rate (3,): rad/s."""
        if self.rows is None or not self.differ(rate, np.zeros(3)):
            return image
        # A direction of the middle is seen by the row that sees it then: one step of fixed-point iteration finds it.
        seen = self._rotated(self.rays, -self.readout_s * self.rows, rate)
        seen = self._rotated(self.rays, -self.readout_s * row_times(self.coarse, seen), rate)
        at = self.pixels + self._shifts(seen)
        return resampled(image, at, wrap=self.camera.kind == "erp")

    def _shifts(self, seen: Pose) -> F32:
        """Displacement (H, W, 2) of each pixel, from the directions (h, w, 3) in which the coarse ones are seen."""
        panorama = self.camera.kind == "erp"
        h, w = seen.shape[:2]
        pixels, valid = self.coarse.project(seen.reshape(-1, 3))
        own, _ = self.coarse.project(self.rays.reshape(-1, 3))
        shift = np.where(valid[:, None], pixels - own, 0.0).reshape(h, w, 2)
        if panorama:
            shift[..., 0] = (shift[..., 0] + 0.5 * w) % w - 0.5 * w
        shift = (shift * (self.camera.width / w)).astype(np.float32)
        size = (self.camera.height, self.camera.width)
        return np.stack([resize_panorama(shift[..., k], size, panorama) for k in (0, 1)], axis=-1)

    @staticmethod
    def rates_along(times: NDArray[np.float64], T_wc: Pose) -> Pose:
        """Angular velocities (N, 3) at ``times`` (N,) along poses (N, 4, 4): the mean of those before and after."""
        steps = np.swapaxes(T_wc[:-1, :3, :3], 1, 2) @ T_wc[1:, :3, :3]
        between = so3_log(steps) / np.maximum(np.diff(times), 1e-6)[:, None]
        middle = 0.5 * (between[1:] + between[:-1])
        first, last = 1.5 * between[:1] - 0.5 * between[1:2], 1.5 * between[-1:] - 0.5 * between[-2:-1]
        return np.concatenate([first, middle, last]) if len(between) > 1 else np.repeat(between, 2, axis=0)

    def _between(self, time: float, T_wc: Pose) -> Pose:
        assert self._last is not None
        before, R = self._last
        return so3_log(R.T @ T_wc[:3, :3]) / max(abs(time - before), 1e-6) * np.sign(time - before or 1.0)

    @staticmethod
    def _rotated(rays: Pose, seconds: Pose, rate: Pose) -> Pose:
        """Rays (H, W, 3), each rotated by ``rate`` (3,) for its own time (H, W) (Rodrigues' formula)."""
        speed = float(np.linalg.norm(rate))
        if speed == 0:
            return rays
        axis, angle = rate / speed, (speed * seconds)[..., None]
        along = (rays @ axis)[..., None] * axis
        return np.asarray(rays * np.cos(angle) + np.cross(axis, rays) * np.sin(angle) + along * (1 - np.cos(angle)))

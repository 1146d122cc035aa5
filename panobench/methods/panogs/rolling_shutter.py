"""Rolling shutter: frames are rectified to the moment of their middle row before anything else sees them.

While the rows of a frame are read, the camera rotates and travels: each row sees the scene from another pose. With a
known readout time and angular velocity the image can be rotated back row by row, and with depth and velocity what it
travelled can be undone, too. (Compare Forssen and Ringaby, "Rectifying rolling shutter video from
hand-held devices", CVPR 2010.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from panobench.cameras.base import Camera
from panobench.cameras.row_times import rates_along, rotated, row_times
from panobench.geometry import so3_log
from panobench.methods.panogs.config import RollingShutterOptions
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import resize_panorama
from panobench.types import Frame

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
        self.camera, self.readout_s = camera, 1e-3 * (options.readout_ms or 0.0)
        self.unknown = options.readout_ms is None
        self.pixel = float(np.sqrt(np.median(camera.solid_angle()[camera.valid_mask()])))
        self.least = options.least_px * self.pixel
        grid = next((g for g in GRIDS_PX if camera.width % (2 * g) == 0 and camera.height % g == 0), 1)
        self.coarse = camera.scaled(camera.width // grid) if self.maybe and grid > 1 else camera
        self.rays = np.nan_to_num(self.coarse.rays())
        v, u = np.indices((camera.height, camera.width), dtype=np.float32)
        self.pixels = np.stack([u, v], axis=-1)
        self._known: dict[int, tuple[Pose, Pose]] = {}
        self._last: tuple[float, Pose] | None = None  # time and pose of the last frame
        self._steps: list[
            Pose
        ] = []  # (6,) between the last frames: rad/s in the camera's axes, velocity in the world's

    @property
    def enabled(self) -> bool:
        return self.readout_s > 0

    @property
    def maybe(self) -> bool:
        """It has a rolling shutter, or nobody knows yet."""
        return self.enabled or self.unknown

    def estimate(self, frames: list[Frame], seed: int, log: Callable[[str], None]) -> None:
        """Find the readout from the first frames, by the feature tracks of ``sparse``, if it is not given."""
        if not self.unknown:
            return
        self.unknown = False
        from panobench.methods.base import MethodContext
        from panobench.methods.sparse.config import SparseConfig
        from panobench.methods.sparse.method import SparseMethod

        tracks = SparseMethod(SparseConfig(loops=False, keyframe_gap=1, readout_ms=None))
        tracks.start(self.camera, MethodContext(seed=seed, log=log))
        for frame in frames:
            tracks.track(frame)
        self.readout_s = 1e-3 * float(tracks.finish().extra.get("readout_ms", 0.0))

    def know(self, frames: list[Frame], T_wc: dict[int, Pose]) -> None:
        """Take the motion of ``frames`` from their poses (4, 4) by index, at least three: the start has no past."""
        posed = [f for f in frames if f.index in T_wc]
        times, T = np.array([f.time for f in posed]), np.stack([T_wc[f.index] for f in posed])
        velocity = np.gradient(T[:, :3, 3], times, axis=0, edge_order=2)
        local = np.einsum("nji,nj->ni", T[:, :3, :3], velocity)
        self._known = {f.index: (w, v) for f, w, v in zip(posed, rates_along(times, T), local)}

    def motion(self, index: int) -> tuple[Pose, Pose] | None:
        """Angular velocity (3,) and velocity (3,) of a frame that is known, in the camera's axes."""
        return self._known.get(index)

    def predicted_rate(self, index: int) -> Pose:
        """Angular velocity (3,) at the next frame, rad/s in the camera's axes, from the rates between the last frames.

        A rate between two frames is that of their middle, so the next frame is one and a half intervals later.
        """
        if index in self._known:
            return self._known[index][0]
        if not self._steps:
            return np.zeros(3)
        if len(self._steps) == 1:
            return self._steps[-1][:3]
        return (self._steps[-1] + 1.5 * (self._steps[-1] - self._steps[-2]))[:3]

    def measured(self, index: int, time: float, T_wc: Pose) -> tuple[Pose, Pose]:
        """Angular velocity (3,) and velocity (3,), in the camera's axes, of a frame just tracked at ``T_wc`` (4, 4).

        Half an interval after the newest step, on the parabola through it and the two before, as far as there are any.
        """
        if index in self._known:
            return self._known[index]
        if self._last is None:
            return np.zeros(3), np.zeros(3)
        newest = self._between(time, T_wc)
        if len(self._steps) < 2:
            now = newest + 0.5 * (newest - self._steps[-1]) if self._steps else newest
        else:
            now = 1.875 * newest - 1.25 * self._steps[-1] + 0.375 * self._steps[-2]
        return now[:3], T_wc[:3, :3].T @ now[3:]

    def record(self, time: float, T_wc: Pose) -> None:
        """A frame's final pose (4, 4)."""
        if self._last is not None:
            self._steps = [*self._steps[-1:], self._between(time, T_wc)]
        self._last = (time, T_wc)

    def forget(self) -> None:
        """The next frame does not follow the last one."""
        self._last, self._steps = None, []

    def differ(self, rate: Pose, other: Pose) -> bool:
        """Whether two angular velocities (3,) rectify pixels to plainly different places."""
        return float(np.linalg.norm(rate - other)) * 0.5 * self.readout_s > self.least

    def travels(self, velocity: Pose, scene_depth: float) -> bool:
        """Whether what the camera travels at ``velocity`` (3,) moves pixels plainly, at a depth in the same unit."""
        return float(np.linalg.norm(velocity)) * 0.5 * self.readout_s / max(scene_depth, 1e-9) > self.least

    def rectified(self, image: Image, rate: Pose, velocity: Pose | None = None, depth_map: F32 | None = None) -> Image:
        """The image (H, W, 3) as a global shutter would have seen it at its middle row.

        rate (3,): rad/s. velocity (3,) a second, with the radial depth (H, W) of the image in the same unit, NaN or 0
        where it is unknown: also what the camera travels is undone. Both in the camera's axes.
        """
        if velocity is None and not self.differ(rate, np.zeros(3)):
            return image
        towards = np.zeros(3)
        if velocity is not None and depth_map is not None:
            towards = velocity * self._inverse(depth_map)[..., None]
        # A direction of the middle is seen by the row that sees it then: one step of fixed-point iteration finds it.
        seen = self.rays
        for _ in range(2):
            at = self.readout_s * row_times(self.coarse, seen)
            seen = rotated(self.rays - towards * at[..., None], -at, rate)
        return resampled(image, self.pixels + self._shifts(seen), wrap=self.camera.kind == "erp")

    def _inverse(self, depth_map: F32) -> Pose:
        """1 / depth (h, w) on the coarse grid, 0 where it is unknown."""
        grid = self.camera.width // self.coarse.width
        coarse = depth_map[grid // 2 :: grid, grid // 2 :: grid].astype(np.float64)
        known = np.isfinite(coarse) & (coarse > 0)
        return np.where(known, 1.0 / np.where(known, coarse, 1.0), 0.0)

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

    def _between(self, time: float, T_wc: Pose) -> Pose:
        assert self._last is not None
        before, T = self._last
        step = np.concatenate([so3_log(T[:3, :3].T @ T_wc[:3, :3]), T_wc[:3, 3] - T[:3, 3]])
        return step / max(abs(time - before), 1e-6) * np.sign(time - before or 1.0)

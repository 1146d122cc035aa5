"""Rolling shutter: the time from a frame's first row to its last, and how the camera moved meanwhile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.row_times import rates_along, velocities_along
from panobench.geometry import so3_log
from panobench.methods.panogs.config import RollingShutterOptions
from panobench.types import Frame

Pose = NDArray[np.float64]


class RollingShutter:
    """Knows the camera's row times and how fast it rotated at the last frames."""

    def __init__(self, camera: Camera, options: RollingShutterOptions) -> None:
        self.camera, self.readout_s = camera, 1e-3 * (options.readout_ms or 0.0)
        self.unknown = options.readout_ms is None
        self.pixel = float(np.sqrt(np.median(camera.solid_angle()[camera.valid_mask()])))
        self.least = options.least_px * self.pixel
        self._known: dict[int, tuple[Pose, Pose]] = {}
        self._last: tuple[float, Pose] | None = None  # time and pose of the last frame
        self._steps: list[
            Pose
        ] = []  # (6,) between the last frames: rad/s in the camera's axes, velocity in the world's

    @property
    def enabled(self) -> bool:
        return self.readout_s != 0

    @property
    def maybe(self) -> bool:
        """It has a rolling shutter, or nobody knows yet."""
        return self.enabled or self.unknown

    def tell(self, readout_s: float) -> None:
        """What was found of a readout that nobody knew; 0 for a global shutter."""
        self.readout_s, self.unknown = readout_s, False

    def know(self, frames: list[Frame], T_wc: dict[int, Pose]) -> None:
        """Take the motion of ``frames`` from their poses (4, 4) by index, at least three: the start has no past."""
        posed = [f for f in frames if f.index in T_wc]
        times, T = np.array([f.time for f in posed]), np.stack([T_wc[f.index] for f in posed])
        rates, velocities = rates_along(times, T), velocities_along(times, T)
        self._known = {f.index: (w, v) for f, w, v in zip(posed, rates, velocities)}

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

        By the cubic through this pose and the three before, as far as there are any.
        """
        if index in self._known:
            return self._known[index]
        if self._last is None:
            return np.zeros(3), np.zeros(3)
        newest = self._between(time, T_wc)
        if len(self._steps) < 2:
            now = newest + 0.5 * (newest - self._steps[-1]) if self._steps else newest
        else:
            now = (11 * newest - 7 * self._steps[-1] + 2 * self._steps[-2]) / 6
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
        return float(np.linalg.norm(rate - other)) * 0.5 * abs(self.readout_s) > self.least

    def travels(self, velocity: Pose, scene_depth: float) -> bool:
        """Whether what the camera travels at ``velocity`` (3,) moves pixels plainly, at a depth in the same unit."""
        return float(np.linalg.norm(velocity)) * 0.5 * abs(self.readout_s) / max(scene_depth, 1e-9) > self.least

    def _between(self, time: float, T_wc: Pose) -> Pose:
        assert self._last is not None
        before, T = self._last
        step = np.concatenate([so3_log(T[:3, :3].T @ T_wc[:3, :3]), T_wc[:3, 3] - T[:3, 3]])
        return step / max(abs(time - before), 1e-6) * np.sign(time - before or 1.0)

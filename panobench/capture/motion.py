"""Where the camera is at any moment: a smooth curve through a sequence's poses, a walker's gait, a swing, levelling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from panobench.geometry import make_pose

Array = NDArray[np.float64]

#: Steps per second of a brisk walk.
STEPS = 1.8
#: Amplitudes of a walk's sway: metres to the right, down and forward; radians of pitch, yaw and roll.
_SWAY = np.array([0.012, 0.018, 0.008])
_TILT = np.deg2rad([0.6, 1.2, 0.9])
#: Seconds of one swing of the ``turn``.
SWING = 2.0
#: Seconds of a slow tilt and of a slow roll.
TILTING = (5.3, 7.1)


class Ride:
    """``pose(t)``: camera-to-world at any time, through every pose of the sequence where nothing is added."""

    def __init__(
        self,
        times: Array,
        T_wc: Array,
        *,
        mount: Array | None = None,
        gait: float = 0.0,
        tilt: float = 0.0,
        turn: float = 0.0,
        seed: int = 0,
    ) -> None:
        """``mount`` (3, 3): the camera's axes in those of an upright one, about whose axes it sways and turns.

        gait: 1 for a brisk walk. tilt: degrees to which it tilts and rolls. turn: peak rate of the swing, degrees
        per second.
        """
        self.times, self.gait, self.tilt, self.turn = times, gait, np.deg2rad(tilt), np.deg2rad(turn)
        self._mount = np.eye(3) if mount is None else mount
        self._place = CubicSpline(times, T_wc[:, :3, 3])
        self._turn = RotationSpline(times, Rotation.from_matrix(T_wc[:, :3, :3]))
        self._phase = np.random.default_rng([seed, 80]).uniform(0, 2 * np.pi, 7)

    def pose(self, t: float) -> Array:
        """(4, 4) at ``t`` seconds; held at the ends."""
        inside = float(np.clip(t, self.times[0], self.times[-1]))
        T = make_pose(self._turn(inside).as_matrix(), self._place(inside))
        if not (self.gait or self.tilt or self.turn):
            return T
        w, p = 2 * np.pi * STEPS * t, self._phase
        wave = np.array([np.sin(0.5 * w + p[0]), np.sin(w + p[1]), np.sin(w + p[2])])
        tilt = np.array([np.sin(w + p[3]), np.sin(0.5 * w + p[4]), np.sin(0.5 * w + p[5])]) * self.gait * _TILT
        tilt[1] += self.turn * SWING / (2 * np.pi) * np.sin(2 * np.pi * t / SWING + p[6])
        tilt[[0, 2]] += self.tilt * np.sin(2 * np.pi * t / np.array(TILTING) + p[[5, 3]])
        sway = make_pose(Rotation.from_euler("yxz", tilt[[1, 0, 2]]).as_matrix(), self.gait * _SWAY * wave)
        M = make_pose(self._mount, np.zeros(3))
        return np.asarray(T @ M.T @ sway @ M)

    def rate(self, t: float, dt: float = 2e-4) -> Array:
        """Angular velocity (3,) in the camera's axes, radians per second."""
        a, b = self.pose(t - dt)[:3, :3], self.pose(t + dt)[:3, :3]
        return np.asarray(Rotation.from_matrix(a.T @ b).as_rotvec() / (2 * dt))


def levelling(T_wc: Array, up: Array, ahead: Array | None = None) -> Array:
    """(3, 3) from a levelled picture's axes to the camera's: the shortest turn that makes y point against ``up`` (3,).

    Like a camera's horizon levelling it leaves the yaw to the camera; with ``ahead`` (3,) the picture looks there.
    """
    if ahead is not None:
        z = ahead - (ahead @ up) * up
        z = z / np.linalg.norm(z)
        return np.asarray(T_wc[:3, :3].T @ np.column_stack([np.cross(-up, z), -up, z]))
    down = -T_wc[:3, :3].T @ up
    axis = np.cross([0.0, 1.0, 0.0], down)
    sine, cosine = float(np.linalg.norm(axis)), float(down[1])
    if sine < 1e-12:
        return np.eye(3)
    return np.asarray(Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix())

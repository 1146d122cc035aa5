"""How somebody walks through a room with a camera on the head: path, pace, steps, and turns of the head.

The figures are those of the challenge's recordings (`hilti-360`): 1.3 m/s, 1.8 steps a second that lift the head by
27 mm rms, rotation of 20 to 40 degrees/s in the median and, in turns of the head, up to 400.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from panobench.rooms.motion import closed_spline
from panobench.rooms.walks import STEPS_HZ, Sway, on_the_head
from panobench.types import Trajectory

Array = NDArray[np.float64]

#: Of the poses, which splines go through, Hz.
POSE_RATE_HZ = 100.0
#: Amplitudes of a brisk walk's sway: metres up, sideways and ahead, radians of yaw, pitch, roll.
_SWAY = np.array([0.038, 0.018, 0.008])
_TILT = np.deg2rad([1.2, 0.7, 0.9])
#: Corners are taken so slowly that no more acceleration points sideways, m/s^2; speeding up takes this long, s.
_SIDEWAYS, _GATHERING_S = 1.2, 0.5
#: Deviation with which the direction of looking follows that of walking, seconds.
_LOOKING_S = 0.35
#: Seconds between two turns of the head, how far it turns (degrees), and how slowly at least (degrees/s).
_PAUSE_S, _FAR_DEG, _SLOW_DEG_S = (3.0, 9.0), (25.0, 120.0), 40.0


@dataclass(frozen=True)
class StrollOptions:
    """seconds: how long. speed: of the walk on straight stretches, m/s.

    turn_deg_s: the fastest turn of the head. gait: 1 for the sway of a brisk walk. still_s: standing at the start; 0
    starts in motion. seed: another path and other turns.
    """

    seconds: float = 60.0
    speed: float = 1.3
    turn_deg_s: float = 400.0
    gait: float = 1.0
    still_s: float = 1.0
    seed: int = 0


def stroll(walk: Array, options: StrollOptions, margin_s: float = 0.3) -> Trajectory:
    """Poses of an upright camera on the head, from ``margin_s`` before time 0 to as long after the end.

    ``walk`` (N, 3): corner points of a closed walk through a room, which is gone round as often as the time allows; a
    seed that is odd goes the other way. Camera axes x right, y down, z forward; world z up.
    """
    rng = np.random.default_rng([options.seed, 83])
    n = int(np.ceil((options.seconds + 2 * margin_s) * POSE_RATE_HZ)) + 1
    times = np.arange(n) / POSE_RATE_HZ - margin_s
    path, length = closed_spline(walk if options.seed % 2 == 0 else walk[::-1])
    s, speed = _progress(path, length, float(rng.uniform(0, length)), times, options)
    glances = _glances(times, options, rng)
    pitch = np.deg2rad(4.0) * np.sin(2 * np.pi * times / 5.3 + rng.uniform(0, 2 * np.pi))
    roll = np.deg2rad(2.0) * np.sin(2 * np.pi * times / 7.1 + rng.uniform(0, 2 * np.pi))
    up, aside, forward, tilts = _sway(times, speed / options.speed, options.gait, rng)
    # Nobody walks the same line twice.
    drift = 0.08 * np.sin(2 * np.pi * s / (1.37 * length) + rng.uniform(0, 2 * np.pi)) + aside
    place, course = path(s % length), path(s % length, 1)
    sway, turns = Sway(up, drift, forward), [glances, tilts[0]]
    delay = _LOOKING_S * POSE_RATE_HZ
    return Trajectory(times, on_the_head(place, course, delay, turns, pitch + tilts[1], roll + tilts[2], sway))


def _progress(
    path: CubicSpline, length: float, start: float, times: Array, options: StrollOptions
) -> tuple[Array, Array]:
    """Metres along the path (N,) and speed (N,) at ``times``; corners are taken more slowly."""
    at = np.linspace(0.0, length, 2000)
    d1, d2 = path(at, 1), path(at, 2)
    bend = np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / np.maximum((d1[:, :2] ** 2).sum(axis=1), 1e-6) ** 1.5
    limit = np.minimum(options.speed, np.sqrt(_SIDEWAYS / np.maximum(bend, 1e-6)))
    dt = 1 / POSE_RATE_HZ
    s, wanted = start, np.zeros(len(times))
    for i, t in enumerate(times):
        moving = options.still_s <= 0 or t >= options.still_s
        wanted[i] = float(np.interp(s % length, at, limit)) if moving else 0.0
        s += wanted[i] * dt
    speed = gaussian_filter1d(wanted, _GATHERING_S * POSE_RATE_HZ / 2, mode="nearest")
    return start + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * dt]), speed


def _glances(times: Array, options: StrollOptions, rng: np.random.Generator) -> Array:
    """Yaw (N,) of a head that turns away and back; the first turn is the fastest, each in minimum jerk."""
    yaw = np.zeros(len(times))
    t, fastest = max(options.still_s, 0.5) + 0.5, True
    while options.turn_deg_s > 0 and t < times[-1]:
        angle = np.deg2rad(rng.uniform(*_FAR_DEG)) * rng.choice([-1.0, 1.0])
        slow = min(_SLOW_DEG_S, options.turn_deg_s)
        for sign in (1.0, -1.0):
            # The logarithm is even: most turns are slow.
            rate = options.turn_deg_s if fastest else np.exp(rng.uniform(*np.log([slow, options.turn_deg_s])))
            fastest = False
            takes = 1.875 * abs(np.rad2deg(angle)) / rate
            x = np.clip((times - t) / takes, 0.0, 1.0)
            yaw += sign * angle * x**3 * (10 - 15 * x + 6 * x * x)
            t += takes + rng.uniform(0.2, 0.8)
        t += rng.uniform(*_PAUSE_S)
    return yaw


def _sway(times: Array, pace: Array, gait: float, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Metres up, to the right and ahead (N,), and yaw, pitch and roll (3, N) of a walk at ``pace`` (1: full)."""
    p = rng.uniform(0, 2 * np.pi, 6)
    w = 2 * np.pi * STEPS_HZ * np.cumsum(0.6 + 0.4 * pace) / POSE_RATE_HZ
    size = gait * pace
    up = _SWAY[0] * (np.sin(w + p[0]) + 0.15 * np.sin(2 * w + p[1])) * size
    aside, forward = _SWAY[1] * np.sin(0.5 * w + p[2]) * size, _SWAY[2] * np.sin(w + p[3]) * size
    tilts = _TILT[:, None] * np.stack([np.sin(0.5 * w + p[4]), np.sin(w + p[5]), np.sin(0.5 * w + p[1])]) * size
    return up, aside, forward, tilts

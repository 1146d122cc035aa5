"""Walks along polylines: rounded corners, an even pace, steps that lift the head, and the head's own turns.

How a camera on the head follows a path is ``on_the_head``, which the simulated recordings (`capture.stroll`) share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from panobench.geometry import make_pose
from panobench.rooms.motion import rotations

Array = NDArray[np.float64]

#: Points per metre of a path, and the distance over which its corners are rounded, metres (one deviation).
PER_METRE, ROUNDING = 20, 0.22
#: Steps a second; their amplitudes: metres up and sideways, radians of pitch and roll.
STEPS_HZ, UP, ASIDE, NOD, SWAY = 1.8, 0.03, 0.015, 0.012, 0.012
#: The direction of looking follows that of walking with this deviation, seconds.
LOOKING_S = 0.5


@dataclass(frozen=True)
class Walk:
    """How somebody walks: frames a second, frames, and how far the head turns to both sides, radians."""

    frames: int
    rate: float = 15.0
    glances: float = 0.7


def rounded(points: Array) -> Array:
    """A polyline (N, 3) as a dense smooth path (M, 3) with rounded corners, points at equal distances."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    dense = np.arange(0.0, s[-1], 1.0 / PER_METRE)
    path = np.stack([np.interp(dense, s, points[:, k]) for k in range(3)], axis=-1)
    return np.asarray(gaussian_filter1d(path, ROUNDING * PER_METRE, axis=0, mode="nearest"))


@dataclass(frozen=True)
class Sway:
    """How steps move a head, metres (N,): up, to the right and ahead."""

    up: Array
    aside: Array
    forward: Array | None = None


def on_the_head(
    place: Array, course: Array, delay: float, turns: Sequence[Array], pitch: Array, roll: Array, sway: Sway
) -> Array:
    """Camera-to-world poses (N, 4, 4) of an upright camera on a head that is carried along a path.

    place, course (N, 3): points of the path and its direction there. delay: with this deviation, in poses, the head
    looks where the walk goes, and turns (N,) by ``turns`` besides. pitch, roll (N,): radians.
    """
    ahead = np.unwrap(np.arctan2(course[:, 1], course[:, 0]))
    yaw = gaussian_filter1d(ahead, delay, mode="nearest")
    for turn in turns:
        yaw = yaw + turn
    across = np.stack([np.sin(ahead), -np.cos(ahead), np.zeros(len(ahead))], axis=-1)
    if sway.forward is not None:
        along = np.stack([np.cos(ahead), np.sin(ahead), np.zeros(len(ahead))], axis=-1)
        place = place + sway.forward[:, None] * along
    place = place + sway.aside[:, None] * across + sway.up[:, None] * [0.0, 0.0, 1.0]
    return make_pose(rotations(yaw, pitch, roll), place)


def walk_poses(points: Array, walk: Walk, rng: np.random.Generator) -> Array:
    """Camera-to-world poses (frames, 4, 4) of an upright camera on the head of somebody who walks a polyline (N, 3)."""
    path = rounded(points)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    spline = CubicSpline(s, path)
    n = walk.frames
    t = np.arange(n) / walk.rate
    pace = 1.0 + 0.12 * np.sin(2 * np.pi * t / 7.3 + rng.uniform(0, 6)) + 0.08 * np.sin(2 * np.pi * t / 3.1)
    along = np.concatenate([[0.0], np.cumsum(pace[1:])])
    along *= s[-1] / along[-1]
    phase = rng.uniform(0, 2 * np.pi, 4)
    steps = 2 * np.pi * STEPS_HZ * t
    glances = walk.glances * np.sin(2 * np.pi * t / 9.1 + phase[0]) * np.sin(2 * np.pi * t / 4.3 + phase[1])
    pitch = 0.06 * np.sin(2 * np.pi * t / 5.3 + phase[2]) + NOD * np.sin(steps)
    roll = 0.03 * np.sin(2 * np.pi * t / 7.1 + phase[3]) + SWAY * np.sin(0.5 * steps)
    sway = Sway(UP * np.sin(steps), ASIDE * np.sin(0.5 * steps))
    return on_the_head(spline(along), spline(along, 1), LOOKING_S * walk.rate, [glances], pitch, roll, sway)

"""Smooth camera trajectories along a closed walk: C2 positions, bounded rotation, clear of the furniture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from panobench.geometry import make_pose
from panobench.rooms.mesh import Mesh
from panobench.rooms.trace import clearances

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """How the camera moves.

    step:     metres per frame, on average.
    yaw_rate: steady yaw per frame, radians. swing: amplitude of a slow yaw oscillation, radians.
    tilt:     amplitude of pitch and roll, radians. bounce: amplitude of the height, metres.
    frames:   length of the sequence. rate: frames per second. period: frames of one oscillation.
    rounds:   number of rounds of the walk, which sets the step instead of ``step``; None: ``step`` does.
    """

    step: float = 0.037
    yaw_rate: float = 0.0
    swing: float = 0.5
    tilt: float = 0.06
    frames: int = 120
    rate: float = 15.0
    period: float = 70.0
    rounds: float | None = None
    bounce: float = 0.03


def closed_spline(walk: Array) -> tuple[CubicSpline, float]:
    """Periodic spline through the corner points (N, 3), by arc length, and its length in metres."""
    p = np.concatenate([walk, walk[:1]])
    for _ in range(3):
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        spline = CubicSpline(s, p, bc_type="periodic")
        fine = spline(np.linspace(0, s[-1], 400))
        p = fine
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    return CubicSpline(s, p, bc_type="periodic"), float(s[-1])


def rotations(yaw: Array, pitch: Array, roll: Array) -> Array:
    """Camera-to-world rotations (N, 3, 3): world z up; camera x right, y down, z forward; yaw 0 looks along +x.

    Positive yaw turns left, positive pitch looks up, positive roll lowers the camera's right side. Radians.
    """
    cy, sy = np.cos(yaw), np.sin(yaw)
    cp, sp = np.cos(pitch), np.sin(pitch)
    forward = np.stack([cy * cp, sy * cp, sp], axis=-1)
    right = np.stack([sy, -cy, np.zeros_like(yaw)], axis=-1)
    down = np.cross(forward, right)
    cr, sr = np.cos(roll)[:, None], np.sin(roll)[:, None]
    x, y = cr * right + sr * down, cr * down - sr * right
    return np.stack([x, y, forward], axis=-1)


def trajectory(walk: Array, motion: Motion, rng: np.random.Generator) -> Array:
    """Camera-to-world poses (N, 4, 4) along a closed walk (M, 3), with random phases and a random start."""
    spline, length = closed_spline(walk)
    n = motion.frames
    i = np.arange(n)
    step = motion.step if motion.rounds is None else motion.rounds * length / n
    phase = rng.uniform(0, 2 * np.pi, 8)
    # The speed varies by a fifth; the camera never stops.
    s = step * (
        i + 0.2 * motion.period / (2 * np.pi) * (np.sin(2 * np.pi * i / motion.period + phase[0]) - np.sin(phase[0]))
    )
    p = spline((s + rng.uniform(0, length)) % length)
    p[:, 2] += motion.bounce * np.sin(2 * np.pi * i / (0.6 * motion.period) + phase[1])
    w = 2 * np.pi * i / motion.period
    yaw = (
        phase[2] + motion.yaw_rate * i + motion.swing * (0.7 * np.sin(w + phase[3]) + 0.3 * np.sin(2.3 * w + phase[4]))
    )
    pitch = motion.tilt * (0.7 * np.sin(1.3 * w + phase[5]) + 0.3 * np.sin(2.9 * w + phase[6]))
    roll = motion.tilt * (0.7 * np.sin(1.7 * w + phase[6]) + 0.3 * np.sin(3.1 * w + phase[7]))
    T = np.zeros((n, 4, 4))
    T[:, :3, :3] = rotations(yaw, pitch, roll)
    T[:, :3, 3] = p
    T[:, 3, 3] = 1.0
    return T


def clear_trajectory(
    walk: Array,
    motion: Motion,
    frames: int,
    mesh: Mesh,
    rng: np.random.Generator,
    clearance: float,
) -> Array:
    """Camera-to-world poses (frames, 4, 4) that keep ``clearance`` metres from everything.

    Tries other phases and heights, then smaller walks. Raises RuntimeError when none is clear: a bug in the plan.
    """
    motion = replace(motion, frames=frames)
    centre = walk.mean(axis=0)
    for attempt in range(60):
        shrink = 1.0 if motion.rounds is not None or attempt < 10 else 0.985 ** (attempt - 9)
        lift = 0.0 if attempt % 3 == 0 else rng.uniform(-0.1, 0.15)
        T = trajectory(centre + (walk - centre) * [shrink, shrink, 1.0] + [0, 0, lift], motion, rng)
        if clearances(mesh.p0, mesh.eu, mesh.ev, np.ascontiguousarray(T[:, :3, 3])).min() >= clearance:
            return T
    raise RuntimeError("no collision-free path through this room")


def novel_poses(T_wc: Array, mesh: Mesh, rng: np.random.Generator, count: int, clearance: float) -> Array:
    """Poses (count, 4, 4) 10 to 45 cm away from the trajectory, with any yaw, and pitch and roll up to 25 degrees."""
    found: list[Array] = []
    while len(found) < count:
        k = int((len(found) + rng.uniform()) / count * len(T_wc))
        away = rng.normal(size=3) * [1, 1, 0.5]
        p = T_wc[k, :3, 3] + away / np.linalg.norm(away) * rng.uniform(0.1, 0.45)
        near = clearances(mesh.p0, mesh.eu, mesh.ev, p[None])[0]
        off = np.linalg.norm(T_wc[:, :3, 3] - p, axis=1).min()
        if near < clearance or off < 0.1:
            continue
        R = rotations(rng.uniform(0, 2 * np.pi, 1), *rng.uniform(-0.44, 0.44, (2, 1)))[0]
        found.append(make_pose(R, p))
    return np.stack(found)

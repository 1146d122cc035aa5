"""Joining two maps: how one lies in the other, told by the frames that have a pose in both, and making them one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, renormalise, so3_log
from panobench.methods.panogs.config import AtlasOptions

if TYPE_CHECKING:
    from panobench.methods.panogs.method import PanogsMethod

Pose = NDArray[np.float64]


def similarity(
    ours: Mapping[int, Pose], theirs: Mapping[int, Pose], depth: float, options: AtlasOptions
) -> Sim3 | None:
    """The motion of their world into ours, by the frames that have a pose (4, 4) in both; None if they do not tell.

    depth: median depth in ours. The newest of the frames are left out where they contradict the others, up to half of
    them: a camera is often wrong already before it is noticed to be lost.
    """
    common = sorted(ours.keys() & theirs.keys())
    for count in range(len(common), max(options.common, len(common) // 2) - 1, -1):
        used = common[:count]
        motion = _similarity(np.stack([ours[i] for i in used]), np.stack([theirs[i] for i in used]), depth, options)
        if motion is not None:
            return motion
    return None


def _similarity(ours: Pose, theirs: Pose, depth: float, o: AtlasOptions) -> Sim3 | None:
    """The same from poses (N, 4, 4). The rotation is that between the views: a straight way would leave a roll free."""
    turns = ours[:, :3, :3] @ theirs[:, :3, :3].transpose(0, 2, 1)
    mean = np.eye(4)
    mean[:3, :3] = turns.mean(axis=0)
    if np.linalg.det(mean[:3, :3]) < 0.5:  # they contradict one another
        return None
    R = renormalise(mean)[:3, :3]
    if np.degrees(np.linalg.norm(so3_log(R.T @ turns), axis=-1).max()) > o.turn:
        return None
    target, source = ours[:, :3, 3], theirs[:, :3, 3] @ R.T
    q, p = target - target.mean(axis=0), source - source.mean(axis=0)
    moved, power = float(np.sqrt((q**2).sum(axis=1).mean())), float((p**2).sum())
    if moved < o.moved * depth or power <= 0:
        return None
    scale = float((q * p).sum()) / power
    residual = float(np.sqrt(((q - scale * p) ** 2).sum(axis=1).mean()))
    if scale <= 0 or residual > o.residual * moved:
        return None
    return Sim3(scale, R, target.mean(axis=0) - scale * source.mean(axis=0))


def join(ours: PanogsMethod, theirs: PanogsMethod, motion: Sim3) -> None:
    """Make two maps one: ``ours`` takes over what ``theirs`` knows, and goes on where that is.

    motion: of their world into ours. ``theirs`` must not be used any more.
    """
    velocity = theirs.tracker.velocity.copy()
    velocity[:3, 3] *= motion.scale
    numbers = ours.trajectory.adopt(theirs.trajectory, motion)
    ours.mapper.adopt(theirs.mapper, motion, numbers)
    ours.places.extend(theirs.places, [n for n, number in enumerate(numbers) if number >= ours.places.count])
    ours.graph.adopt(theirs.graph)
    ours.lag.buffer.clear()
    ours.relocaliser.found(ours.trajectory[max(theirs.trajectory)], theirs.tracker.pyramid[-1])
    ours.tracker.velocity = velocity
    ours.exposure = theirs.exposure
    ours.late_rates.forget()
    ours.shutter.forget()
    ours.phase = theirs.phase
    for index, row in theirs.numbers.items():
        ours.numbers[index] = row | ({"height": motion.scale * row["height"]} if "height" in row else {})
    for index in theirs.moving:
        ours.moving.put(index, theirs.moving[index])

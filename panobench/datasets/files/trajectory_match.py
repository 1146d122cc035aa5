"""Poses at image times: nearest match, and interpolation on SE(3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import make_pose, so3_exp, so3_log
from panobench.types import Trajectory

Array = NDArray[np.float64]
#: The resolution of float64 for seconds since 1970 is a quarter of a microsecond.
_ROUNDING_S = 1e-6


def nearest(times: Array, wanted: Array) -> NDArray[np.intp]:
    """Index of the nearest of ``times`` (N,), sorted, for each of ``wanted`` (M,)."""
    right = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(times) - 1)
    return np.where(np.abs(times[right] - wanted) < np.abs(wanted - times[left]), right, left)


def match_to_times(trajectory: Trajectory, times: Array, tolerance: float) -> Trajectory:
    """The poses within ``tolerance`` seconds of ``times``, with exactly those times; may be empty.

    A pose is used for one time only.
    """
    index = nearest(trajectory.times, times)
    distance = np.abs(trajectory.times[index] - times)
    order = np.lexsort((distance, index))
    first = np.ones(len(order), dtype=bool)
    first[1:] = index[order][1:] != index[order][:-1]
    keep = np.zeros(len(times), dtype=bool)
    keep[order[first]] = True
    keep &= distance <= tolerance
    return Trajectory(times[keep].copy(), trajectory.T_wc[index[keep]].copy())


def interpolate_poses(trajectory: Trajectory, times: Array, *, max_gap: float = np.inf) -> Trajectory:
    """Poses at those of ``times`` that are within the trajectory and in no gap longer than ``max_gap`` seconds.

    Positions are interpolated linearly, rotations by R0 exp(s log(R0^T R1)), the geodesic of SO(3).
    """
    t = trajectory.times
    if len(t) < 2:
        return match_to_times(trajectory, times, 0.0)
    right = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    left = right - 1
    inside = (times >= t[0] - _ROUNDING_S) & (times <= t[-1] + _ROUNDING_S)
    exact = (times == t[left]) | (times == t[right])
    keep = inside & (exact | (t[right] - t[left] <= max_gap))
    left, right, wanted = left[keep], right[keep], times[keep]
    s = np.clip((wanted - t[left]) / (t[right] - t[left]), 0.0, 1.0)
    R0, R1 = trajectory.T_wc[left, :3, :3], trajectory.T_wc[right, :3, :3]
    R = R0 @ so3_exp(s[:, None] * so3_log(np.swapaxes(R0, 1, 2) @ R1))
    p = (1 - s)[:, None] * trajectory.positions[left] + s[:, None] * trajectory.positions[right]
    return Trajectory(wanted.copy(), make_pose(R, p))

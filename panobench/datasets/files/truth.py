"""Ground truth that has stamps of its own: its poses at the times of frames, and what to say of how many have one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_match import interpolate_poses, match_to_times
from panobench.types import Trajectory

#: A row this near to a frame was meant for it, where rows are as many as frames; stamps are rounded.
TIME_TOLERANCE_S = 1e-3
#: Poses are interpolated between rows that are at most so far apart: truth of 10 Hz, with its jitter, is bridged.
MAX_GAP_S = 0.12
#: A smaller share of frames with truth is explained.
_FEW = 0.9
#: Rows per frame beyond which the rows were not made for the frames.
_DENSE = 1.5


def truth_at_frames(recorded: Trajectory, times: NDArray[np.float64]) -> Trajectory | None:
    """Poses at those of ``times`` for which ``recorded`` tells one; None if there is no such frame.

    Rows that are stamped as the frames, up to a millisecond, are taken as they are. Otherwise positions are
    interpolated linearly and rotations on the geodesic, in gaps of at most MAX_GAP_S and never beyond the ends.
    """
    if not len(recorded):
        return None
    near = match_to_times(recorded, times, TIME_TOLERANCE_S)
    start, end = recorded.times[0] - TIME_TOLERANCE_S, recorded.times[-1] + TIME_TOLERANCE_S
    covered = int(((times >= start) & (times <= end)).sum())
    rows = int(((recorded.times >= times[0] - MAX_GAP_S) & (recorded.times <= times[-1] + MAX_GAP_S)).sum())
    if len(near) < covered or rows > _DENSE * max(covered, 1) + 1:
        near = _joined(interpolate_poses(recorded, times, max_gap=MAX_GAP_S), near)
    return near if len(near) else None


def _joined(first: Trajectory, second: Trajectory) -> Trajectory:
    """All of ``first``, and what ``second`` has at other times."""
    other = second.select(~np.isin(second.times, first.times))
    times, poses = np.concatenate([first.times, other.times]), np.concatenate([first.T_wc, other.T_wc])
    order = np.argsort(times)
    return Trajectory(times[order], poses[order])


def truth_remarks(sequence: FrameSequence) -> list[str]:
    """What to say where some frames of a sequence have no ground truth although there is some."""
    truth, recorded = sequence.groundtruth, sequence.recorded_truth
    if truth is None and recorded is None:
        return []
    have, count = 0 if truth is None else len(truth), len(sequence)
    if have == count:
        return []
    line = f"ground truth for {have} of {count} frames"
    if recorded is not None and len(recorded) and have < _FEW * count:
        spans = f"it spans {_span(recorded.times)} s, the frames {_span(sequence.times)} s"
        apart = recorded.times[-1] < sequence.times[0] or recorded.times[0] > sequence.times[-1]
        line += f": {spans}"
        line += "; another clock? --align-time looks for a constant offset" if apart else f"; {_density(recorded)}"
    return [line]


def _span(times: NDArray[np.float64]) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f}"


def _density(recorded: Trajectory) -> str:
    if len(recorded) < 2:
        return "it has one pose"
    step = float(np.median(np.diff(recorded.times)))
    return f"its poses are {step:.3g} s apart, gaps over {MAX_GAP_S:g} s are not bridged"

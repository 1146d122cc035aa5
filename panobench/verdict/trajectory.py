"""Evidence in a trajectory itself, and in a second one of the same frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import umeyama
from panobench.metrics.base import MIN_TRACKED
from panobench.types import Trajectory
from panobench.verdict.base import Evidence, falling

#: Coverage at which a run has failed for certain.
COVERAGE_BAD = 0.5
#: A step this many times as long as fast motion around it is a jump; steps before and after that are compared.
JUMP, JUMP_BAD, AROUND = 4.0, 25.0, 15
#: Deviation of two methods' paths, over the path's length, that is as good as none, and that is as bad as it gets.
AGREE, DISAGREE = 0.008, 0.03
#: Frames that two trajectories must share to be compared, and the share of the frames given.
SHARED_MIN, SHARED_SHARE = 8, 0.3


def coverage(tracked: int, given: int) -> Evidence:
    """The share of frames that have a pose."""
    share = tracked / given if given else 0.0
    trust = 1.0 if share >= 0.995 else falling(share, 0.97, COVERAGE_BAD)
    if share < MIN_TRACKED:
        trust = min(trust, 0.04)
    return Evidence(
        "coverage", trust, f"{tracked} of {given} frames have a pose" if given else "it ended before its first frame",
        "look at the frames without a pose in frames.csv; slower motion, more light or a mask may help",
    )  # fmt: skip


def steadiness(trajectory: Trajectory) -> Evidence:
    """Jumps: steps far longer than those around them."""
    if len(trajectory) < AROUND:
        return Evidence("steadiness", 1.0, "too few poses to look for jumps")
    speed = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) / np.diff(trajectory.times)
    worst, where = 0.0, 0
    floor = 0.2 * float(np.quantile(speed, 0.9))
    for k in range(len(speed)):
        around = np.delete(speed[max(k - AROUND, 0) : k + AROUND + 1], min(k, AROUND))
        usual = max(float(np.quantile(around, 0.9)), floor)
        if usual > 0 and speed[k] / usual > worst:
            worst, where = float(speed[k] / usual), k
    trust = falling(worst, JUMP, JUMP_BAD)
    if trust == 1.0:
        return Evidence("steadiness", 1.0, "the path has no jumps")
    return Evidence(
        "steadiness", trust, f"the path jumps at {trajectory.times[where + 1]:.2f} s, {worst:.0f} times the usual step",
        "look at the frames there: a cut, a blocked lens or a person close to the camera",
    )  # fmt: skip


def second_method(trajectory: Trajectory, other: Trajectory, name: str, given: int) -> Evidence | None:
    """Agreement with another method's path of the same frames after Sim(3) alignment.

    None where the other method found too little to say anything.
    """
    _, mine, theirs = np.intersect1d(trajectory.times, other.times, return_indices=True)
    if len(mine) < max(SHARED_MIN, SHARED_SHARE * given):
        return None
    p, q = trajectory.positions[mine], other.positions[theirs]
    deviation = path_deviation(p, q)
    if deviation is None:
        return None
    return Evidence(
        f"check by {name}", falling(deviation, AGREE, DISAGREE),
        f"its path and that of '{name}' differ by {100 * deviation:.2f}% of the path",
        "one of the two is wrong: compare both in `panobench report`, mask what moves with the camera (--mask), or "
        "use the method whose path looks right",
    )  # fmt: skip


def path_deviation(p: NDArray[np.float64], q: NDArray[np.float64]) -> float | None:
    """RMS distance of positions p, q (N, 3) after Sim(3) alignment over q's path length; None if q does not move."""
    length = float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
    if length <= 0 or float(np.ptp(q, axis=0).max()) < 1e-9 or float(np.ptp(p, axis=0).max()) < 1e-9:
        return None
    fit = umeyama(p, q)
    return float(np.sqrt(((fit.apply_points(p) - q) ** 2).sum(axis=1).mean())) / length

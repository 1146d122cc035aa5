"""Evidence in a trajectory itself, and in a second one of the same frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import distances_along, umeyama
from panobench.metrics.base import MIN_TRACKED
from panobench.types import Trajectory
from panobench.verdict.base import Evidence, falling

#: Coverage at which a run has failed for certain.
COVERAGE_BAD = 0.5
#: A step this many times as long as fast motion around it is a jump; steps before and after that are compared.
JUMP, JUMP_BAD, AROUND = 4.0, 25.0, 15
#: The same for both steps to a frame and back again. A camera that turns back goes by its usual steps.
BESIDE, BESIDE_BAD = 1.3, 2.5
#: Trust in a path that jumps at most, where a second method's path has the same jumps: the recording has them.
SEEN_TWICE = 0.8
#: Difference of the positions beside a jump, over its length, up to which two paths have the same jump.
SAME_JUMP = 0.2
#: Deviation of two methods' paths, over the path's length, that is as good as none, and that is as bad as it gets.
AGREE, DISAGREE = 0.008, 0.03
#: Frames that two trajectories must share to be compared, and the share of the frames given.
SHARED_MIN, SHARED_SHARE = 8, 0.3
#: Trust in a path of whose frames a second method has too few: what made it fail may have misled this one.
UNCONFIRMED = 0.45


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


def steadiness(trajectory: Trajectory, confirming: Sequence[Trajectory] = ()) -> Evidence:
    """Jumps: steps far longer than those around them; and single frames beside the path, there and back.

    confirming: other methods' paths that agree with this one. What they have, too, is in the recording: frames that
    are missing, or a part that begins again.
    """
    if len(trajectory) < AROUND:
        return Evidence("steadiness", 1.0, "too few poses to look for jumps")
    moves = np.diff(trajectory.positions, axis=0) / np.diff(trajectory.times)[:, None]
    speed = np.linalg.norm(moves, axis=1)
    lengths = speed / np.maximum(_usual(speed), 1e-12)
    back = np.einsum("ni,ni->n", moves[:-1], moves[1:]) < 0
    beside = np.where(back, np.minimum(lengths[:-1], lengths[1:]), 0.0)
    beside /= max(1.5 * float(np.quantile(beside, 0.98)), 1.0)  # of a slow camera all frames are a bit to the side
    jump, aside = int(np.argmax(lengths)), int(np.argmax(beside))
    evidence = [
        ("the path jumps", falling(float(lengths[jump]), JUMP, JUMP_BAD), jump, float(lengths[jump])),
        ("one frame lies beside the path", falling(float(beside[aside]), BESIDE, BESIDE_BAD), aside, beside[aside]),
    ]
    what, trust, where, times = min(evidence, key=lambda e: e[1])
    if trust == 1.0:
        return Evidence("steadiness", 1.0, "the path has no jumps")
    if any(_has_step(other, trajectory, where) for other in confirming):
        trust = max(trust, SEEN_TWICE)
    return Evidence(
        "steadiness", trust, f"{what} at {trajectory.times[where + 1]:.2f} s, by {times:.1f} times the usual step",
        "look at the frames there: a cut, a blocked lens or a person close to the camera",
    )  # fmt: skip


def _has_step(other: Trajectory, trajectory: Trajectory, step: int) -> bool:
    """Whether another path of the same frames has the same step, after Sim(3) alignment."""
    _, mine, theirs = np.intersect1d(trajectory.times, other.times, return_indices=True)
    p, q = trajectory.positions, other.positions[theirs]
    at = np.searchsorted(mine, [step, step + 1])
    if at[1] >= len(mine) or not np.array_equal(mine[at], [step, step + 1]):
        return False
    moved = umeyama(q, p[mine]).apply_points(q[at])
    own = p[step + 1] - p[step]
    return bool(np.linalg.norm(moved[1] - moved[0] - own) < SAME_JUMP * np.linalg.norm(own))


def _usual(speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,): how fast the camera moves around each of the steps (N,) when it is fast."""
    floor = 0.2 * float(np.quantile(speed, 0.9))
    around = (np.delete(speed[max(k - AROUND, 0) : k + AROUND + 1], min(k, AROUND)) for k in range(len(speed)))
    return np.array([max(float(np.quantile(a, 0.9)), floor) for a in around])


def second_method(
    trajectory: Trajectory, other: Trajectory, name: str, given: int, *, unsure: bool = False
) -> Evidence | None:
    """Agreement with another method's path of the same frames after Sim(3) alignment.

    unsure: the other's own evidence speaks against it: where it disagrees, it is more likely to be the wrong one.

    None where the camera does not move, or this path is too short. A method that lost its way confirms nothing.
    """
    _, mine, theirs = np.intersect1d(trajectory.times, other.times, return_indices=True)
    enough = max(SHARED_MIN, SHARED_SHARE * given)
    if len(mine) < enough <= len(other):
        return None
    if len(mine) < enough:
        return Evidence(
            f"check by {name}", UNCONFIRMED, f"'{name}' lost its way: it has {len(other)} of {given} frames",
            "look at the path in `panobench report`; mask what moves with the camera (--mask), or check it by another "
            "method (--check)",
        )  # fmt: skip
    p, q = trajectory.positions[mine], other.positions[theirs]
    deviation = path_deviation(p, q)
    if deviation is None:
        return None
    doubted = ", whose own features do not fit it," if unsure else ""
    return Evidence(
        f"check by {name}", falling(deviation, AGREE, DISAGREE, UNCONFIRMED if unsure else 0.02),
        f"its path and that of '{name}'{doubted} differ by {100 * deviation:.2f}% of the path",
        "one of the two is wrong: compare both in `panobench report`, mask what moves with the camera (--mask), or "
        "use the method whose path looks right",
    )  # fmt: skip


def path_deviation(p: NDArray[np.float64], q: NDArray[np.float64]) -> float | None:
    """RMS distance of positions p, q (N, 3) after Sim(3) alignment over q's path length; None if q does not move."""
    length = float(distances_along(q)[-1])
    if length <= 0 or float(np.ptp(q, axis=0).max()) < 1e-9 or float(np.ptp(p, axis=0).max()) < 1e-9:
        return None
    fit = umeyama(p, q)
    return float(np.sqrt(((fit.apply_points(p) - q) ** 2).sum(axis=1).mean())) / length

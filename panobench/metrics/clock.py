"""The constant offset between two clocks, from the motion that both have seen.

For each offset tried, one trajectory is interpolated at the times of the other, shifted, and aligned to it by a
similarity; what is left of positions (relative to their spread) and of orientations is the cost. No scale, no common
world and no first guess is needed, but motion that is not the same all the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.trajectory_match import interpolate_poses
from panobench.geometry import so3_log, umeyama
from panobench.types import Trajectory

Array = NDArray[np.float64]
#: Poses of the estimate that are looked at, evenly spread.
_SAMPLES = 200
#: This share of the shorter trajectory has to meet the other one.
_OVERLAP = 0.6
#: Offsets tried at first; then the best is refined.
_MAX_TRIED = 4000
#: Offsets whose cost is below this, or half as much again as the best one's, fit nearly as well.
_NEAR = 0.01
#: A cost above this is no agreement.
_DISAGREES = 0.25


@dataclass(frozen=True)
class ClockOffset:
    """offset_s: to be added to the truth's times. cost: what is left at this offset, relative to the motion. within_s:
    offsets up to this far away fit nearly as well.
    """

    offset_s: float
    cost: float
    within_s: float


def find_offset(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> ClockOffset | None:
    """The offset between the clocks of an estimate (N poses) and of the truth; None where the motion shows none.

    ``max_gap_s``: truth is interpolated across gaps of at most this.
    """
    if len(estimate) < 8 or len(truth) < 8:
        return None
    some = estimate.select(np.unique(np.linspace(0, len(estimate) - 1, _SAMPLES).astype(int)))
    shorter = min(float(np.ptp(some.times)), float(np.ptp(truth.times)))
    first = some.times[0] - truth.times[-1] + _OVERLAP * shorter
    last = some.times[-1] - truth.times[0] - _OVERLAP * shorter
    interval = float(np.median(np.diff(estimate.times)))
    step = max(interval / 2, (last - first) / _MAX_TRIED)
    tried = np.arange(first, last + step, step)
    costs = np.array([_cost(some, truth, offset, max_gap_s) for offset in tried])
    if not np.isfinite(costs).any():
        return None
    best = float(tried[int(np.nanargmin(costs))])
    while step > 1e-5:
        step /= 2
        around = [best + k * step for k in (-2, -1, 0, 1, 2)]
        found = [_cost(some, truth, offset, max_gap_s) for offset in around]
        best = around[int(np.nanargmin(found))] if np.isfinite(found).any() else best
    cost = _cost(some, truth, best, max_gap_s)
    if not cost < _DISAGREES:
        return None
    good = tried[np.nan_to_num(costs, nan=np.inf) <= max(1.5 * cost, _NEAR)]
    return ClockOffset(best, cost, float(np.abs(good - best).max(initial=0.0)))


def _cost(estimate: Trajectory, truth: Trajectory, offset: float, max_gap_s: float) -> float:
    """Root mean square of what alignment leaves of positions and orientations; NaN with too little in common."""
    there = interpolate_poses(truth, estimate.times - offset, max_gap=max_gap_s)
    share = min(1.0, float(np.ptp(truth.times)) / float(np.ptp(estimate.times)))
    if len(there) < max(6, int(_OVERLAP * share * len(estimate))):
        return float("nan")
    # the times wanted are those of the estimate minus the offset, exactly
    here = estimate.select(np.isin(estimate.times - offset, there.times))
    spread = float(np.sqrt(((there.positions - there.positions.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if spread < 1e-9:
        return float("nan")
    left = umeyama(here.positions, there.positions).apply_points(here.positions) - there.positions
    moved = float((left**2).sum(axis=1).mean()) / spread**2
    relative = there.T_wc[:, :3, :3] @ np.swapaxes(here.T_wc[:, :3, :3], 1, 2)
    U, _, Vt = np.linalg.svd(relative.sum(axis=0))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    turned = float((so3_log(R.T @ relative) ** 2).sum(axis=-1).mean())
    return float(np.sqrt(moved + turned))

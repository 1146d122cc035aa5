"""Match estimated poses to true ones, and find the transform between the two worlds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, umeyama
from panobench.types import Trajectory

#: Times that differ by no more belong to the same frame.
SAME_TIME_S = 1e-6


@dataclass(frozen=True)
class Matched:
    """Estimated and true poses of the same frames, in time order."""

    estimate: Trajectory
    truth: Trajectory

    def __len__(self) -> int:
        return len(self.estimate)


def match(estimate: Trajectory, truth: Trajectory | None) -> Matched | None:
    """Poses at equal times; None without truth or without a common time."""
    if truth is None or len(truth) == 0 or len(estimate) == 0:
        return None
    nearest = np.clip(np.searchsorted(truth.times, estimate.times - SAME_TIME_S), 0, len(truth) - 1)
    same = np.flatnonzero(np.abs(truth.times[nearest] - estimate.times) <= SAME_TIME_S)
    return Matched(estimate.select(same), truth.select(nearest[same])) if len(same) else None


def moves(positions: NDArray[np.float64]) -> bool:
    """Whether the positions (N, 3) spread enough to define a scale: more than a micrometre."""
    return len(positions) > 1 and float(np.ptp(positions, axis=0).max()) > 1e-6


def world_alignment(matched: Matched) -> Sim3:
    """The transform from the estimate's world to the true one by positions and orientations, to render from true poses.

    The rotation is the chordal mean of R_true R_estimated^T over all frames: unlike the one from positions
    alone it is well defined on a straight path. Scale and translation then follow by
    least squares from the positions.
    """
    relative = matched.truth.T_wc[:, :3, :3] @ np.swapaxes(matched.estimate.T_wc[:, :3, :3], 1, 2)
    U, _, Vt = np.linalg.svd(relative.sum(axis=0))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    source, target = matched.estimate.positions @ R.T, matched.truth.positions
    s0, t0 = source - source.mean(axis=0), target - target.mean(axis=0)
    spread = float((s0**2).sum())
    scale = 1.0 if spread < 1e-12 else float((s0 * t0).sum()) / spread
    if scale <= 0:
        return umeyama(matched.estimate.positions, matched.truth.positions)
    return Sim3(scale, R, target.mean(axis=0) - scale * source.mean(axis=0))

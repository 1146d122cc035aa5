"""What holds the poses of a trajectory where they were, beside its factors.

A tracker whose map has wrong depths makes steps of a wrong length, mostly too short: errors of the depth pass for
motion that explains nothing, as noise in a regressor does. All steps are wrong in the same way, so a prior on many
positions holds their sum far more firmly than the deviation of each of them says. So there are two parts. A position
that the factors move far is held less; how a correction *bends* is held all along, which keeps the noise of single
frames out and costs a stretch nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, se3_log

Array = NDArray[np.float64]

#: A position that the factors move is held by a deviation at most so many times as large.
LOOSEST = 10.0


@dataclass(frozen=True)
class PosePrior:
    """Standard deviations of a pose as it was: translation (in the trajectory's unit), rotation (rad).

    bend: of the second difference of a correction of the positions, from frame to frame, in the trajectory's unit.
    With it the prior on a position is robust (Cauchy's weight). None: positions are held one by one.
    """

    translation: float
    rotation: float
    bend: float | None = None


class HeldPoses:
    """The prior's part of the normal equations of N poses, over left twists of T_cw.

    T_wc (N, 4, 4): the poses as they were.
    """

    def __init__(self, T_wc: Array, prior: PosePrior) -> None:
        self.prior, self.before, self.positions = prior, invert_pose(T_wc), T_wc[:, :3, 3].copy()
        self.count = len(T_wc)
        #: (6N,) diagonal of the information.
        self.unit = np.tile(np.repeat([1.0 / prior.translation**2, 1.0 / prior.rotation**2], 3), self.count)
        self._bend: Array | None = None
        if prior.bend is not None:
            differences = np.diff(np.eye(self.count), 2, axis=0)
            self._bend = differences.T @ differences / prior.bend**2
            self._hold(np.full(self.count, 1.0 / LOOSEST**2))  # at first, so that what the factors want can be seen

    def gradient(self, T_cw: Array) -> Array:
        """(6N,) at the poses ``T_cw`` (N, 4, 4)."""
        g = self.unit * se3_log(T_cw @ invert_pose(self.before)).ravel()
        if self._bend is not None:
            # A left twist (v, w) of T_cw moves the position by -R_cw^T v.
            towards = np.einsum("nij,nj->ni", T_cw[:, :3, :3], self._bend @ self._moved(T_cw))
            g.reshape(self.count, 6)[:, :3] -= towards
        return g

    def bend(self, T_cw: Array) -> tuple[NDArray[np.int64], Array] | None:
        """The cells (3N,) of the translations, and the information (3N, 3N) of bends; None where these are free."""
        if self._bend is None:
            return None
        R = T_cw[:, :3, :3]
        information = np.einsum("iab,ij,jcb->iajc", R, self._bend, R, optimize=True)
        cells = (6 * np.arange(self.count)[:, None] + np.arange(3)).ravel()
        return cells, information.reshape(3 * self.count, 3 * self.count)

    def reweigh(self, T_cw: Array) -> None:
        """Hold each position by how far it has been moved."""
        if self._bend is not None:
            moved = np.linalg.norm(self._moved(T_cw), axis=1) / self.prior.translation
            self._hold(np.maximum(1.0 / (1.0 + moved**2), 1.0 / LOOSEST**2))

    def _hold(self, shares: Array) -> None:
        """shares (N,): of the full weight of the prior on each position."""
        self.unit.reshape(self.count, 6)[:, :3] = (shares / self.prior.translation**2)[:, None]

    def _moved(self, T_cw: Array) -> Array:
        """(N, 3): from where the positions were."""
        return np.asarray(invert_pose(T_cw)[:, :3, 3] - self.positions)

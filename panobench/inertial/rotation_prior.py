"""What a gyroscope says of a camera's rotation, as a factor beside what its images say.

A pose in a narrow view can trade a turn for a step aside, and the gyroscope tells the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import so3_log

Array = NDArray[np.float64]

#: From so many deviations on the factor counts linearly: a gyroscope may be saturated, a mounting loose.
LINEAR_FROM = 3.0


@dataclass(frozen=True)
class RotationPrior:
    """R (3, 3): what a rotation is expected to be. sigma: its standard deviation per axis, rad.

    The rotation is perturbed on its left, R <- exp(w) R.
    """

    R: Array
    sigma: float

    @property
    def inverse(self) -> RotationPrior:
        """Of the inverse rotation."""
        return RotationPrior(self.R.T, self.sigma)

    def seen_from(self, T_reference: Array) -> RotationPrior:
        """Of a camera's axes in those of a reference camera at ``T_reference`` (4, 4), both in the same world."""
        return RotationPrior(T_reference[:3, :3].T @ self.R, self.sigma)

    def cost(self, R: Array) -> float:
        """Squared deviations of a rotation (3, 3); linear, as Huber's loss is, from ``LINEAR_FROM`` of them on."""
        deviations = float(np.linalg.norm(self._turn(R))) / self.sigma
        return deviations**2 if deviations <= LINEAR_FROM else LINEAR_FROM * (2 * deviations - LINEAR_FROM)

    def linearise(self, R: Array) -> tuple[float, Array]:
        """Information, which is this number times the identity, and gradient (3,) of half the cost, per rad."""
        turn = self._turn(R)
        deviations = float(np.linalg.norm(turn)) / self.sigma
        information = min(1.0, LINEAR_FROM / max(deviations, 1e-12)) / self.sigma**2
        return information, information * turn

    def _turn(self, R: Array) -> Array:
        """(3,) from what is expected to ``R``, rad."""
        return np.asarray(so3_log(R @ self.R.T))

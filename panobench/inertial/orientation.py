"""Orientation of the body by integrating the gyroscope."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import so3_exp
from panobench.inertial.samples import Samples

Array = NDArray[np.float64]


class Orientation:
    """R_0b(t): the body's axes at time t in those at the first sample, for a constant bias (3,) of the gyroscope."""

    def __init__(self, samples: Samples, bias: Array) -> None:
        self.times = samples.times
        rate = (samples.gyro[1:] + samples.gyro[:-1]) / 2 - bias
        self.turns = rate * np.diff(samples.times)[:, None]
        self.R = np.concatenate([np.eye(3)[None], cumulative_product(so3_exp(self.turns))])

    def at(self, times: Array) -> Array:
        """R_0b (M, 3, 3) at times (M,); before the first sample and after the last the rate is constant."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = (times - self.times[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray(self.R[k] @ so3_exp(share[:, None] * self.turns[k]))


def cumulative_product(R: Array) -> Array:
    """R_1, R_1 R_2, R_1 R_2 R_3 ... of matrices (N, 3, 3), in blocks so that few steps are in Python."""
    n = len(R)
    width = max(int(np.sqrt(n)), 1)
    rows = -(-n // width)
    padded = np.concatenate([R, np.broadcast_to(np.eye(3), (rows * width - n, 3, 3))]).reshape(rows, width, 3, 3)
    for column in range(1, width):
        padded[:, column] = padded[:, column - 1] @ padded[:, column]
    for row in range(1, rows):
        padded[row] = padded[row - 1, -1] @ padded[row]
    return np.asarray(padded.reshape(-1, 3, 3)[:n])

"""The noise of inertial samples, estimated from the samples themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Sum of the squared coefficients of a third difference (1, -3, 3, -1).
_GAIN = 20.0
#: Median of the absolute value of a standard normal variable.
_NORMAL_MEDIAN = 0.6745


def sample_noise(samples: NDArray[np.float64], floor: float = 0.0) -> float:
    """Standard deviation of the white noise of samples (N, 3) at a steady rate, in their unit, at least ``floor``.

    Motion of a few Hz vanishes in third differences of a signal at 100 Hz and more, white noise does not; the median
    keeps impacts out. Vibration counts as noise, which is what a filter has to be told. The root mean square over the
    axes.
    """
    if len(samples) < 8:
        return floor
    spread = np.median(np.abs(np.diff(samples, 3, axis=0)), axis=0) / _NORMAL_MEDIAN
    return max(floor, float(np.sqrt(np.mean(spread**2) / _GAIN)))

"""What a panorama's rows weigh in a loss, by latitude."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

#: "cosine" weighs a pixel by its solid angle; "uniform" and "gaussian" serve the ablation of the loss.
Weighting = Literal["cosine", "uniform", "gaussian"]
#: Standard deviation of the Gaussian weight, degrees of latitude.
GAUSSIAN_LATITUDE_DEG = 30.0


def latitude_weight(latitude: NDArray[Any], weighting: Weighting) -> NDArray[Any]:
    """Weights (...), at most 1, of pixels at ``latitude`` (...) in radians."""
    if weighting == "uniform":
        return np.ones_like(latitude)
    if weighting == "cosine":
        return np.asarray(np.cos(latitude))
    return np.asarray(np.exp(-0.5 * (np.rad2deg(latitude) / GAUSSIAN_LATITUDE_DEG) ** 2))

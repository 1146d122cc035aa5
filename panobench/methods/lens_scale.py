"""The scale that the distances between a rig's lenses tell: when it is metric, and what a run says of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

#: A scale whose standard deviation is larger than this share is not called metric.
METRIC_SIGMA = 0.1
#: What aligned images may all be off in the same sense, pixels: interpolation pulls them by a few hundredths.
BIAS_PX = 0.02


def scale_numbers(lenses: int, sigma: float) -> dict[str, Any]:
    """For run.json: what the scale comes from, and its relative standard deviation, inf where nothing tells it."""
    return {
        "lenses": lenses,
        "scale_from": "the distance between the lenses",
        "scale_sigma_percent": 100 * sigma if np.isfinite(sigma) else None,
    }


def is_metric(sigma: float, warn: Callable[[str], None]) -> bool:
    """Whether a scale of relative standard deviation ``sigma`` counts as metric; if not, ``warn`` is told."""
    if sigma <= METRIC_SIGMA:
        return True
    warn("the rig turned too little for its lenses' distance to tell the scale: it is not metric")
    return False

"""Latitude weights other than the cosine for alignment, so that the ablation of the loss covers tracking too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from panobench.kernels.weighting import Weighting, latitude_weight
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import Reference
from panobench.photometric.warp import ERP


def reweighted(reference: Reference, weighting: Weighting) -> Reference:
    """The reference of a panorama with the weights of ``latitude_weight``; that of another camera stays as it is."""
    if weighting == "cosine" or reference.code != ERP:
        return reference
    levels = [replace(level, weight=_weights(level.points, weighting)) for level in reference.levels]
    return replace(reference, levels=levels)


def _weights(points: F32, weighting: Weighting) -> F32:
    """Weights (n,) of points (3, n) in the camera frame."""
    latitude = np.arctan2(-points[1], np.hypot(points[0], points[2]))
    return latitude_weight(latitude, weighting).astype(np.float32)

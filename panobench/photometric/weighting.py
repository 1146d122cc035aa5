"""Other latitude weights for alignment than the cosine: the loss ablation, in tracking as in mapping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from panobench.photometric.pyramid import F32
from panobench.photometric.reference import Reference
from panobench.photometric.warp import ERP
from panobench.splat.loss import GAUSSIAN_LATITUDE_DEG, Weighting


def reweighted(reference: Reference, weighting: Weighting) -> Reference:
    """The reference with a panorama's pixels weighted as the loss of that name weighs them; others stay as they are."""
    if weighting == "cosine" or reference.code != ERP:
        return reference
    levels = [replace(level, weight=_weights(level.points, weighting)) for level in reference.levels]
    return replace(reference, levels=levels)


def _weights(points: F32, weighting: Weighting) -> F32:
    """(n,) for points (3, n) in the camera frame."""
    if weighting == "uniform":
        return np.ones(points.shape[1], np.float32)
    lat = np.rad2deg(np.arctan2(-points[1], np.hypot(points[0], points[2])))
    return np.exp(-0.5 * (lat / GAUSSIAN_LATITUDE_DEG) ** 2).astype(np.float32)

"""Splitting: discs that are too coarse for a view are halved, so the map gets finer where the camera comes near.

A disc is as large as its share of the image that it was seeded in. From nearer it covers many pixels, of which it can
only show the mean. Where the image differs from the render, two halves replace it, side by side along its longer axis
and in its own plane, so that the surface stays where it is. (3D Gaussian splatting splits by the gradient across the
image instead: Kerbl et al., 2023.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import matrix_from_quaternion
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.render import Render

#: Offset of the halves from the centre, in standard deviations of the whole, and their length over the whole's. Two
#: normal distributions of 0.7 sigma at +-0.7 sigma have the variance of the whole.
_OFFSET, _SHORTER = 0.7, 0.7
#: Least sum of blending weights, in pixels, of a disc that may be split.
_SEEN_MIN = 1.0


@dataclass(frozen=True)
class SplitRule:
    """error: mean absolute colour error (of 1) over its pixels from which a disc is split; size_px: and its least
    standard deviation there, in pixels; share: of all Gaussians split at once, the worst first.
    """

    error: float = 0.06
    size_px: float = 1.0
    share: float = 0.05


def too_coarse(
    render: Render, gaussians: GaussianMap, position: NDArray[np.float64], error: F32, rule: SplitRule
) -> NDArray[np.intp]:
    """Indices to split by a ``render`` of these Gaussians from ``position`` (3,).

    error (H, W): absolute colour error, 0 where the image has nothing to say.
    """
    seen = np.stack([error, (error > 0).astype(np.float32), np.zeros_like(error)])
    wrong, weight, _ = render.weighted_sums(seen).T
    distance = np.linalg.norm(gaussians.means - position.astype(np.float32), axis=1)
    size = np.exp(gaussians.log_scales.max(axis=1)) / np.maximum(distance, 1e-6) / render.pixel_angle
    chosen = np.flatnonzero((weight > _SEEN_MIN) & (wrong > rule.error * weight) & (size > rule.size_px))
    most = int(rule.share * len(gaussians))
    if len(chosen) > most:
        chosen = np.sort(chosen[np.argsort(-wrong[chosen], kind="stable")[:most]])
    return chosen


def halves(gaussians: GaussianMap, which: NDArray[np.intp]) -> GaussianMap:
    """The two halves of each of ``which``, first all of one side, then all of the other."""
    whole = gaussians.select(which)
    axis = whole.log_scales.argmax(axis=1)
    rows = np.arange(len(which))
    step = _OFFSET * np.exp(whole.log_scales[rows, axis])[:, None] * _column(whole.quats, axis)
    log_scales = whole.log_scales.copy()
    log_scales[rows, axis] += np.float32(np.log(_SHORTER))
    sides = [
        GaussianMap(whole.means + sign * step, log_scales, whole.quats, whole.opacity_logits, whole.colours)
        for sign in (np.float32(1), np.float32(-1))
    ]
    return sides[0].concat(sides[1])


def _column(quats: F32, axis: NDArray[np.intp]) -> F32:
    """Column ``axis`` of each rotation: that axis of the disc in the world, (N, 3)."""
    R = matrix_from_quaternion(quats)
    return np.asarray(R[np.arange(len(quats)), :, axis], dtype=np.float32)

"""Growing and thinning a map while it is fitted: clone, split, prune, fade.

Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (SIGGRAPH 2023), section 5: Gaussians that
are pulled across the image are cloned when small and split in two when large; transparent and huge ones go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import matrix_from_quaternion
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.splat.gaussians import GaussianMap

#: The halves of a split Gaussian are smaller by this factor.
SHRINK = 1.6


def logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def grow(trainable: TrainableMap, threshold: float, small: float, rng: np.random.Generator, most: int) -> int:
    """Clone and split where the mean pull exceeds ``threshold``; returns how many Gaussians were added.

    small: Gaussians up to this size (largest standard deviation) are cloned, larger ones split. most: the map never
    gets more Gaussians than that; the strongest pulled come first. Starts the statistics anew.
    """
    mean_pull = trainable.pull / np.maximum(trainable.pulls, 1)
    trainable.pull[:], trainable.pulls[:] = 0, 0
    index = np.flatnonzero(mean_pull > threshold)
    room = max(0, most - len(trainable))
    if len(index) > room:
        index = np.sort(index[np.argsort(-mean_pull[index], kind="stable")[:room]])
    if len(index) == 0:
        return 0
    large = np.exp(trainable.gaussians.log_scales[index].max(axis=1)) > small
    clones, parents = index[~large], index[large]
    anchors = trainable.anchors
    new_anchors = np.concatenate([anchors[clones], anchors[parents], anchors[parents]])
    new = trainable.gaussians.select(clones).concat(_halves(trainable.gaussians.select(parents), rng))
    keep = np.ones(len(trainable), bool)
    keep[parents] = False
    trainable.keep(keep)
    trainable.append(new, new_anchors)
    return len(index)


def _halves(parents: GaussianMap, rng: np.random.Generator) -> GaussianMap:
    """Two smaller Gaussians for each, drawn from it."""
    twice = parents.concat(parents)
    local = rng.normal(size=(len(twice), 3)) * np.exp(twice.log_scales)
    R = matrix_from_quaternion(twice.quats)
    twice.means += np.einsum("nij,nj->ni", R, local).astype(np.float32)
    twice.log_scales -= np.float32(np.log(SHRINK))
    return twice


def prune(trainable: TrainableMap, opacity: float, largest: float, also: NDArray[np.bool_] | None = None) -> int:
    """Drop Gaussians below ``opacity``, larger than ``largest``, not finite, or in ``also`` (N,); returns how many."""
    g = trainable.gaussians
    bad = (g.opacity_logits < logit(opacity)) | (g.log_scales.max(axis=1) > np.log(largest))
    bad |= ~(np.isfinite(g.means).all(axis=1) & np.isfinite(g.log_scales).all(axis=1))
    if also is not None:
        bad |= also
    count = int(np.count_nonzero(bad))
    if count:
        trainable.keep(~bad)
    return count


def fade(trainable: TrainableMap, opacity: float, which: NDArray[np.bool_] | None = None) -> None:
    """Lower opacities to ``opacity`` where they exceed it, and forget how Adam was moving them."""
    low = np.float32(logit(opacity))
    chosen = trainable.gaussians.opacity_logits > low
    if which is not None:
        chosen &= which
    trainable.gaussians.update(opacity_logits=np.where(chosen, low, trainable.gaussians.opacity_logits))
    trainable.adam.m[chosen, 10] = 0
    trainable.adam.v[chosen, 10] = 0

"""Growing and thinning a map while it is fitted: clone, split, prune, fade.

Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (SIGGRAPH 2023), section 5: Gaussians that
are pulled across the image are cloned when small and split in two when large; transparent and huge ones go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import matrix_from_quaternion
from panobench.methods.splatting.trainer import GaussianTrainer
from panobench.splat.gaussians import GaussianMap

#: The halves of a split Gaussian are smaller by this factor.
SHRINK = 1.6


def logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def grow(trainer: GaussianTrainer, threshold: float, small: float, rng: np.random.Generator, most: int) -> int:
    """Clone and split where the mean pull exceeds ``threshold``; returns how many Gaussians were added.

    small: Gaussians up to this size (largest standard deviation) are cloned, larger ones split. most: the map never
    gets more Gaussians than that; the strongest pulled come first. Starts the statistics anew.
    """
    mean_pull = trainer.pull / np.maximum(trainer.views, 1)
    trainer.pull[:], trainer.views[:] = 0, 0
    index = np.flatnonzero(mean_pull > threshold)
    room = max(0, most - len(trainer))
    if len(index) > room:
        index = np.sort(index[np.argsort(-mean_pull[index], kind="stable")[:room]])
    if len(index) == 0:
        return 0
    large = np.exp(trainer.map.log_scales[index].max(axis=1)) > small
    clones, parents = index[~large], index[large]
    origin = trainer.origin
    new_origin = np.concatenate([origin[clones], origin[parents], origin[parents]])
    new = trainer.map.select(clones).concat(_halves(trainer.map.select(parents), rng))
    keep = np.ones(len(trainer), bool)
    keep[parents] = False
    trainer.keep(keep)
    trainer.add(new, new_origin)
    return len(index)


def _halves(parents: GaussianMap, rng: np.random.Generator) -> GaussianMap:
    """Two smaller Gaussians for each, drawn from it."""
    twice = parents.concat(parents)
    local = rng.normal(size=(len(twice), 3)) * np.exp(twice.log_scales)
    R = matrix_from_quaternion(twice.quats)
    twice.means += np.einsum("nij,nj->ni", R, local).astype(np.float32)
    twice.log_scales -= np.float32(np.log(SHRINK))
    return twice


def prune(trainer: GaussianTrainer, opacity: float, largest: float, also: NDArray[np.bool_] | None = None) -> int:
    """Drop Gaussians below ``opacity``, larger than ``largest``, not finite, or in ``also`` (N,); returns how many."""
    g = trainer.map
    bad = (g.opacity_logits < logit(opacity)) | (g.log_scales.max(axis=1) > np.log(largest))
    bad |= ~(np.isfinite(g.means).all(axis=1) & np.isfinite(g.log_scales).all(axis=1))
    if also is not None:
        bad |= also
    count = int(np.count_nonzero(bad))
    if count:
        trainer.keep(~bad)
    return count


def fade(trainer: GaussianTrainer, opacity: float, which: NDArray[np.bool_] | None = None) -> None:
    """Lower opacities to ``opacity`` where they exceed it, and forget how Adam was moving them."""
    low = np.float32(logit(opacity))
    chosen = trainer.map.opacity_logits > low
    if which is not None:
        chosen &= which
    trainer.map.opacity_logits[chosen] = low
    trainer.adam.m[chosen, 10] = 0
    trainer.adam.v[chosen, 10] = 0

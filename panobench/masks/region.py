"""From votes to a mask: connected regions with strong evidence, closed, without holes, widened."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from panobench.masks.panorama import Panorama

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Votes before anything is seen, and what they say: the scene rather.
PRIOR, PRIOR_VOTE = 0.6, -0.3
#: A region goes as far as evidence above LOW and has some above HIGH.
LOW, HIGH = -0.2, 0.3
#: Share of the sphere of strong evidence below which a region is chance, and of the largest hole that is filled.
LEAST_SEED, LARGEST_HOLE = 2e-3, 0.02
#: Gaps up to this many pixels of the panorama are closed; what is found is widened by so many.
CLOSE, WIDEN = 3, 1


def hidden_region(p: Panorama, votes: Array, weights: Array) -> Mask:
    """(H, W): directions that do not show the scene."""
    evidence = p.mean(((votes + PRIOR * PRIOR_VOTE) / (weights + PRIOR)).astype(np.float32), 3)
    region = evidence > LOW
    strong = np.where(evidence > HIGH, p.area, 0.0)
    parts, count = components(region)
    seeds = np.bincount(parts.ravel(), weights=strong.ravel(), minlength=count + 1)
    region &= seeds[parts] > LEAST_SEED
    if not region.any():
        return np.asarray(region)
    region |= ~grown(p, ~grown(p, region, CLOSE), CLOSE)
    holes, count = components(~region)
    sizes = np.bincount(holes.ravel(), weights=p.area.ravel(), minlength=count + 1)
    region |= (holes > 0) & (sizes[holes] < LARGEST_HOLE)
    return grown(p, region, WIDEN)


def grown(p: Panorama, mask: Mask, pixels: int) -> Mask:
    """``mask`` widened by an angle of so many pixels, over seam and poles."""
    return np.asarray(p.mean(mask.astype(np.float32), 2 * pixels + 1) > 0.5 / (2 * pixels + 1) ** 2)


def components(mask: Mask) -> tuple[NDArray[np.int32], int]:
    """Connected regions of a panorama (H, W), numbered from 1: its left and right border are neighbours."""
    parts, count = label(mask, structure=np.ones((3, 3)))
    parent = np.arange(count + 1)

    def root(i: int) -> int:
        while parent[i] != i:
            i = int(parent[i])
        return i

    pairs = [(parts[:, 0], np.roll(parts[:, -1], k)) for k in (-1, 0, 1)]
    half = parts.shape[1] // 2
    pairs += [(row, np.roll(row, half)) for row in (parts[0], parts[-1])]
    for a, b in pairs:
        for i, j in {(int(i), int(j)) for i, j in zip(a, b) if i and j}:
            parent[max(root(i), root(j))] = min(root(i), root(j))
    return np.array([root(i) for i in range(count + 1)], dtype=np.int32)[parts], count


def to_camera(p: Panorama, mask: Mask, rays: Array) -> Mask:
    """The panorama's ``mask`` along a camera's rays (H, W, 3); False where it has none."""
    seen = p.at(mask.astype(np.float32), np.nan_to_num(rays, nan=1.0)) > 0.4
    return np.asarray(seen & np.isfinite(rays).all(axis=-1))


def smooth_outline(mask: Mask) -> Mask:
    """The same at its size with a rounder outline."""
    blurred = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2.0)
    return np.asarray(blurred > 0.4)

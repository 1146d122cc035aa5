"""How what carries the camera turns in the picture, from its own look.

A levelled picture does not tilt with the camera, so its carrier does the opposite, and nothing of the scene tells by
how much. The carrier looks much the same in all frames, though: it is followed from frame to frame as one that turns
about the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from panobench.geometry import so3_exp, so3_log
from panobench.masks.panorama import TRUNCATED, Image, Panorama

Array = NDArray[np.float64]

#: Degrees by which a turn is tried about each axis, one step size after the other, and how often each.
STEPS, REPEATS = (12.0, 6.0, 3.0, 1.5, 0.75), 4
#: How much of each frame passes into what the carrier is believed to look like.
RENEW = 0.2
#: Least gain of a step: less is noise.
LEAST_GAIN = 1e-4


@dataclass(frozen=True)
class Followed:
    """turns: R (3, 3) by frame, from a direction in the first frame to the same part of the carrier in that frame.

    apart: mean difference of the carrier's look between the first frame and the others if it turns so, over that if it
    stays where it is.
    """

    turns: dict[int, Array]
    apart: float

    @property
    def angle(self) -> float:
        """Radians by which it turns in nine frames of ten at most."""
        angles = [float(np.linalg.norm(so3_log(R))) for R in self.turns.values()]
        return float(np.percentile(angles, 90))


def follow_carrier(panorama: Panorama, images: Mapping[int, Image], region: NDArray[np.bool_], first: int) -> Followed:
    """Follow it from frame ``first`` both ways.

    images: normalised (H, W, 3), by frame. region (H, W): where the carrier is in ``first``.
    """
    rays = panorama.rays[region].astype(np.float64)
    weights = panorama.area[region] / panorama.area[region].sum()
    indices = sorted(images)
    start = indices.index(first)
    found = {first: np.eye(3)}
    turning, still = 0.0, 0.0
    for way in (indices[start + 1 :], indices[:start][::-1]):
        at_first = _seen(panorama, images[first], rays)
        R, look = np.eye(3), at_first
        for index in way:
            R = _aligned(panorama, images[index], look, rays, weights, R)
            found[index] = R
            now = _seen(panorama, images[index], rays @ R.T)
            look = (1 - RENEW) * look + RENEW * now
            turning += _apart(now, at_first, weights)
            still += _apart(_seen(panorama, images[index], rays), at_first, weights)
    return Followed(found, turning / still if still > 0 else 1.0)


def interpolated(turns: Mapping[int, Array], count: int) -> list[Array]:
    """R (3, 3) for each of ``count`` frames from those of some."""
    known = sorted(turns)
    if len(known) == 1:
        return [turns[known[0]]] * count
    between = Slerp(known, Rotation.from_matrix(np.stack([turns[i] for i in known])))
    return list(between(np.clip(np.arange(count), known[0], known[-1])).as_matrix())


def _aligned(panorama: Panorama, image: Image, look: Image, rays: Array, weights: Array, start: Array) -> Array:
    """The turn near ``start`` at which ``image`` looks like ``look`` (N, 3) along ``rays``, by pattern search."""

    def cost(R: Array) -> float:
        return _apart(_seen(panorama, image, rays @ R.T), look, weights)

    best, least = start, cost(start)
    for step in STEPS:
        turns = [so3_exp(sign * np.deg2rad(step) * axis) for axis in np.eye(3) for sign in (1.0, -1.0)]
        for _ in range(REPEATS):
            tried = [(cost(turn @ best), turn @ best) for turn in turns]
            now, R = min(tried, key=lambda one: one[0])
            if now > least - LEAST_GAIN:
                break
            best, least = R, now
    return best


def _apart(a: Image, b: Image, weights: Array) -> float:
    """Mean difference of values (N, 3)."""
    return float(np.minimum(np.abs(a - b).mean(axis=1), TRUNCATED) @ weights)


def _seen(panorama: Panorama, image: Image, directions: Array) -> Image:
    """Values (N, 3) of ``image`` along ``directions`` (N, 3)."""
    return panorama.at(image, directions[:, None])[:, 0]

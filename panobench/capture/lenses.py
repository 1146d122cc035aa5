"""Two lenses back to back and how their pictures become a panorama: seam, parallax, row times, exposure, colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Half the angle over which one lens's picture fades into the other's, radians.
BLEND = np.deg2rad(4.0)
#: Things at this distance are stitched without a seam, metres.
STITCHED_AT = 2.0


@dataclass(frozen=True)
class Lens:
    """One lens: where it sits in the camera's axes (3,) and its share of each pixel (H, W)."""

    origin: Array
    weight: Array

    def rays(self, rays: Array) -> Array:
        """Unit rays (H, W, 3) of the panorama -> the directions in which the lens sees what is stitched there."""
        if not self.origin.any():
            return rays
        seen = STITCHED_AT * rays - self.origin
        return np.asarray(seen / np.linalg.norm(seen, axis=-1, keepdims=True))


def lens_weights(rays: Array) -> tuple[Array, Array]:
    """Shares (H, W) of the front and the back lens along unit rays (H, W, 3) in the camera's axes."""
    angle = np.arcsin(np.clip(rays[..., 2], -1.0, 1.0))
    x = np.clip(0.5 + 0.5 * angle / BLEND, 0.0, 1.0)
    front = x * x * (3 - 2 * x)
    return front, 1.0 - front


def lenses(rays: Array, baseline: float) -> list[Lens]:
    """The lenses ``baseline`` metres apart along the camera's z axis; one in the middle if that is 0."""
    if not baseline:
        return [Lens(np.zeros(3), np.ones(rays.shape[:2]))]
    half = np.array([0.0, 0.0, 0.5 * baseline])
    return [Lens(o, w) for o, w in zip((half, -half), lens_weights(rays))]


def gains(t: float, stops: float, seed: int = 0) -> Array:
    """Linear factors (2, 3) of the two lenses' RGB: exposure and white balance that drift apart and together."""
    p = np.random.default_rng([seed, 81]).uniform(0, 2 * np.pi, (2, 2))
    exposure = stops * np.sin(2 * np.pi * t / np.array([3.1, 4.3]) + p[:, 0])
    warmth = stops / 3 * np.sin(2 * np.pi * t / 5.7 + p[:, 1])
    return np.asarray(2.0 ** (exposure[:, None] + warmth[:, None] * [1.0, 0.3, -1.0]))

"""Spheres of Gaussians: one within another is a scene in which something is hidden."""

from __future__ import annotations

import numpy as np

from panobench.splat.gaussians import GaussianMap


def shell(radius: float, grey: float, n: int = 1500) -> GaussianMap:
    """An opaque sphere of discs about the origin."""
    k = np.arange(n) + 0.5
    y, lon = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    d = np.stack([np.sqrt(1 - y**2) * np.sin(lon), y, np.sqrt(1 - y**2) * np.cos(lon)], axis=1)
    size = np.full((n, 3), np.log(radius * np.sqrt(4 * np.pi / n)))
    return GaussianMap(radius * d, size, np.tile([1.0, 0, 0, 0], (n, 1)), np.full(n, 4.0), np.full((n, 3), grey))

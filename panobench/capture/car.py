"""A car with the camera on a mast above its roof: rigid, glossy, its paint mirrors the surroundings."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panobench.capture.operator import camera_axes, share_hidden
from panobench.capture.solids import PAINT, PLAIN, Builder, Material, Solids

Array = NDArray[np.float64]

_COLOURS = ((0.35, 0.02, 0.02), (0.03, 0.06, 0.22), (0.55, 0.55, 0.55), (0.02, 0.02, 0.02), (0.05, 0.16, 0.08))
_GLASS = Material(PAINT, (0.01, 0.012, 0.012))
_RUBBER = Material(PLAIN, (0.015, 0.015, 0.015))


class Car:
    """``solids(t)`` as ``Operator`` has it."""

    def __init__(self, share: float, seed: int = 0) -> None:
        self.share = share
        rng = np.random.default_rng([seed, 78])
        colour = _COLOURS[int(rng.integers(len(_COLOURS)))]
        self._paint = Material(PAINT, colour, colour)
        self._phase = rng.uniform(0, 2 * np.pi, 2)

    def solids(self, t: float) -> Solids:
        shake = 0.002 * np.array([np.sin(31 * t + self._phase[0]), 0.0, np.sin(23 * t + self._phase[1])])
        return self._seen_from(self._height, shake)

    @cached_property
    def _height(self) -> float:
        """Of the camera above the ground."""
        low, high = 1.56, 3.2
        for _ in range(10):
            middle = 0.5 * (low + high)
            if share_hidden([self._seen_from(middle, np.zeros(3))]) > self.share:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def _seen_from(self, height: float, shake: Array) -> Solids:
        add, eye, paint = Builder(), np.eye(3), self._paint
        add.ellipsoid((0, -0.1, 1.36), (0.64, 1.10, 0.12), eye, paint)  # roof
        add.ellipsoid((0, 0.1, 1.475), (0.34, 0.30, 0.012), eye, _GLASS)  # sunroof
        add.ellipsoid((0, -0.05, 1.12), (0.74, 1.45, 0.30), eye, _GLASS)  # windows
        add.ellipsoid((0, 1.55, 0.83), (0.80, 0.85, 0.17), eye, paint)  # bonnet
        add.ellipsoid((0, -1.60, 0.88), (0.78, 0.65, 0.18), eye, paint)  # boot
        add.ellipsoid((0, 0.0, 0.62), (0.90, 2.35, 0.42), eye, paint)
        for x in (-1.0, 1.0):
            add.cone((0.56 * x, -0.9, 1.46), (0.56 * x, 0.6, 1.47), 0.018, 0.018, _RUBBER)  # rails
            add.cone((0.62 * x, 0.7, 1.34), (0.76 * x, 1.25, 0.98), 0.035, 0.04, paint)  # pillars
            add.ellipsoid((0.98 * x, 0.85, 1.02), (0.11, 0.06, 0.08), eye, paint)  # mirrors
            for y in (-1.4, 1.4):
                add.ellipsoid((0.82 * x, y, 0.32), (0.10, 0.33, 0.32), eye, _RUBBER)
            add.cone((0.1 * x, 0.72, 1.33), (0.5 * x, 1.1, 1.10), 0.008, 0.006, _RUBBER)  # wipers
        add.cone((0, -0.1, 1.46), (0, -0.1, height - 0.05), 0.02, 0.015, _RUBBER)  # the mast
        return add.build().moved(camera_axes(np.array([0.0, -0.1, height]) + shake))

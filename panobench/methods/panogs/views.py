"""Frames as the mapper sees them: image, refinable pose, exposure; and which of them are keyframes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise, se3_exp
from panobench.methods.panogs.occlusion import Occlusion


@dataclass
class PoseAdam:
    """Adam on the pose tangent (6,), T_cw <- exp(step) T_cw; translation and rotation have their own rates."""

    m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    v: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    steps: int = 0

    def step(self, T_cw: NDArray[np.float64], gradient: NDArray[np.float64], rates: tuple[float, float]) -> NDArray:
        """The pose after one step along ``gradient`` (translation, rotation) with ``rates`` for the two halves."""
        self.steps += 1
        self.m = 0.9 * self.m + 0.1 * gradient
        self.v = 0.999 * self.v + 0.001 * gradient**2
        unit = (self.m / (1 - 0.9**self.steps)) / (np.sqrt(self.v / (1 - 0.999**self.steps)) + 1e-15)
        return renormalise(se3_exp(-unit * np.repeat(rates, 3)) @ T_cw)


@dataclass
class View:
    """An image with its camera-to-world pose. gain, offset: frame = exp(gain) render + offset."""

    index: int
    image: NDArray[np.uint8]
    T_wc: NDArray[np.float64]
    gain: float = 0.0
    offset: float = 0.0
    touched: NDArray[np.int32] | None = None
    pose_adam: PoseAdam = field(default_factory=PoseAdam)
    occlusion: Occlusion = field(default_factory=Occlusion)

    @property
    def position(self) -> NDArray[np.float64]:
        return self.T_wc[:3, 3]

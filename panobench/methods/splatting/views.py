"""Views a map is fitted to: an image with a pose that is refined along with the map, and what it sees of the map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, renormalise, se3_exp
from panobench.methods.splatting.culling import VisibilityCulling


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
class SeenGaussians:
    """The Gaussians a view sees. seen (M,): by id, for all ids that had been given out when it was made."""

    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, touched: NDArray[np.int32], ids: NDArray[np.int32], next_id: int) -> SeenGaussians:
        """From the pixels (N,) that each of the Gaussians ``ids`` (N,) touches in a render of the view."""
        seen = np.zeros(next_id, bool)
        seen[ids] = touched > 0
        return cls(seen)

    def inherit(self, parents: NDArray[np.int32], children: NDArray[np.int32], next_id: int) -> None:
        """Children (K,) that replace their parents (K,) are seen where these were."""
        grown = np.zeros(next_id, bool)
        grown[: len(self.seen)] = self.seen
        grown[children] = grown[parents]
        self.seen = grown


@dataclass(eq=False)
class View:
    """An image (H, W, 3) with its camera-to-world pose (4, 4). gain, offset: image = exp(gain) render + offset.

    seen: the Gaussians it sees, for co-visibility; None where nobody asks. visible (H, W): where it shows the scene;
    None: wherever the camera sees.
    """

    index: int
    image: NDArray[np.uint8]
    T_wc: NDArray[np.float64]
    gain: float = 0.0
    offset: float = 0.0
    seen: SeenGaussians | None = None
    visible: NDArray[np.bool_] | None = None
    pose_adam: PoseAdam = field(default_factory=PoseAdam)
    culling: VisibilityCulling = field(default_factory=VisibilityCulling)

    @property
    def position(self) -> NDArray[np.float64]:
        return self.T_wc[:3, 3]

    def moved(self, motion: Sim3) -> None:
        """Go along into another world and another map, where what it sees is not known yet."""
        self.T_wc = motion.apply_poses(self.T_wc)
        self.seen, self.pose_adam, self.culling = None, PoseAdam(), VisibilityCulling()

"""A Gaussian map that is being fitted: parameters, optimiser state and bookkeeping, one row per Gaussian in each.

Rows come and go together; what must outlive that refers to Gaussians by id.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3
from panobench.splat.backend import empty_map, new_adam
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.motion import move

if TYPE_CHECKING:
    from panobench.gpu.device import Device


class TrainableMap:
    """Owner of the map's rows.

    gaussians: the parameters. adam: their optimiser. anchors (N,): number of the keyframe that brought each Gaussian,
    whose corrections it follows. ids (N,): each Gaussian's own number, ascending; an id is never given twice, and those
    below ``next_id`` have been given out. pull, pulls (N,): summed length of the gradient across the image, in units of
    2 / width, and the number of views in the sum (see ``densify``).
    """

    def __init__(self, beta1: float = 0.9, beta2: float = 0.999, device: Device | None = None) -> None:
        """device: where parameters and optimiser stay; None for the CPU."""
        self.gaussians = empty_map(device)
        self.adam = new_adam(0, beta1, beta2, device)
        self.anchors, self.ids = np.zeros(0, np.int32), np.zeros(0, np.int32)
        self.pull: F32 = np.zeros(0, np.float32)
        self.pulls = np.zeros(0, np.int32)
        self.next_id = 0

    def __len__(self) -> int:
        return len(self.gaussians)

    def append(self, new: GaussianMap, anchors: int | NDArray[np.int32]) -> NDArray[np.int32]:
        """Add Gaussians with a fresh optimiser state; returns their ids (M,). anchors: one for all, or (M,)."""
        n = len(new)
        ids = self.next_id + np.arange(n, dtype=np.int32)
        self.gaussians = self.gaussians.concat(new)
        self.adam.extend(n)
        self.anchors = np.concatenate([self.anchors, np.broadcast_to(np.asarray(anchors, np.int32), (n,))])
        self.ids = np.concatenate([self.ids, ids])
        self.pull = np.concatenate([self.pull, np.zeros(n, np.float32)])
        self.pulls = np.concatenate([self.pulls, np.zeros(n, np.int32)])
        self.next_id += n
        return ids

    def keep(self, which: NDArray[np.bool_]) -> None:
        """Drop all Gaussians but these (N,)."""
        self.gaussians = self.gaussians.kept(which)
        self.adam.select(which)
        self.anchors, self.ids = np.compress(which, self.anchors), np.compress(which, self.ids)
        self.pull, self.pulls = np.compress(which, self.pull), np.compress(which, self.pulls)

    def drop(self, which: NDArray[np.bool_]) -> int:
        """Drop these Gaussians (N,); returns how many there were."""
        count = int(np.count_nonzero(which))
        if count:
            self.keep(~which)
        return count

    def follow(self, motions: list[Sim3]) -> None:
        """Move each Gaussian, in place, by the motion (old world to new world) of its anchor."""
        move(self.gaussians, self.anchors, motions)

    def move(self, which: NDArray[np.bool_], motion: Sim3) -> None:
        """Move these Gaussians (N,), in place, by one motion (old world to new world)."""
        self.gaussians.assign(which, self.gaussians.select(which).transformed(motion))

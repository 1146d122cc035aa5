"""Poses as a file gives them, each with what says which frame it belongs to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.types import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseList:
    """T_wc (N, 4, 4) in the order of the file, and exactly one of the keys.

    times:     (N,) seconds, increasing.
    names:     N image names, as the file has them.
    numbers:   (N,) frame numbers from 0; ``counted`` says that they are only the poses' places in the file, which then
               has one for every frame.
    format:    what the file was recognised as. scaled: False where the format knows no metres (COLMAP, nerfstudio).
    """

    T_wc: Array
    format: str
    times: Array | None = None
    names: tuple[str, ...] | None = None
    numbers: NDArray[np.int64] | None = None
    counted: bool = False
    scaled: bool = True
    remarks: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.T_wc)

    def inverted(self) -> PoseList:
        """Of a file that holds world-to-camera poses."""
        return replace(self, T_wc=invert_pose(self.T_wc))

    @property
    def key(self) -> str:
        """What the poses are found by, for people."""
        return "time" if self.times is not None else "image name" if self.names is not None else "frame number"

    def trajectory(self) -> Trajectory:
        """Of poses by time."""
        assert self.times is not None
        return Trajectory(self.times, self.T_wc)

"""A map that outlives its run: what a method needs to find itself in it, or to go on with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.splat.gaussians import GaussianMap


@dataclass(frozen=True)
class SavedKeyframe:
    """An image (H, W, 3) RGB uint8 of the map's camera with its pose T_wc (4, 4) in the map's frame.

    index, time: of the frame in the run that made it; time in seconds.
    """

    index: int
    time: float
    T_wc: NDArray[np.float64]
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class SavedMap:
    """gaussians: in the map's frame. anchors (N,): for each, the number of the keyframe that brought it.

    camera: of the keyframes, mask included. keyframes: in the order they were made, at least one. scene_depth: median
    radial depth of the first map, the unit of a method's distances. metric: the map's unit is the metre. made_by: the
    method.
    """

    gaussians: GaussianMap
    anchors: NDArray[np.int32]
    camera: Camera
    keyframes: tuple[SavedKeyframe, ...]
    scene_depth: float
    metric: bool
    made_by: str

    def __post_init__(self) -> None:
        if not self.keyframes:
            raise ValueError("a saved map needs a keyframe")
        if len(self.anchors) != len(self.gaussians):
            raise ValueError(f"{len(self.anchors)} anchors for {len(self.gaussians)} Gaussians")

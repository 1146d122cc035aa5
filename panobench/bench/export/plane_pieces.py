"""The pieces of a plane that nothing is seen through, by what views confirm of their depth.

A plane goes on for ever, a wall does not: it ends, and has doorways and windows. A piece of it is solid where twice as
many pixels of all views lie on it as behind it. Depth behind a solid piece is made up: a floor that shines, say, shows
a second room below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.planes import Plane

Float = NDArray[np.float32]
Array = NDArray[np.float64]

#: Edge of a piece, and how far away the most distant one is seen, both over the scene's median depth.
EDGE, FARTHEST = 0.02, 6.0
#: Points whose distance from a plane is less than this part of that from the camera are on it.
NEAR = 0.01
#: Pixels on a plane for each behind it that make a piece solid, and how many are enough to tell. They are counted in
#: the smallest square around it that has enough, of so many pieces on a side.
SHARE, ENOUGH, AROUND = 2.0, 50, (3, 7, 15, 31)


@dataclass(frozen=True)
class PlanePieces:
    """across, down (3,): axes of the plane; middle (3,): between its pieces, in the world; edge: of a piece.

    solid (N, N): by across and down.
    """

    plane: Plane
    across: Array
    down: Array
    middle: Array
    edge: float
    solid: NDArray[np.bool_]

    def seen(self, rays: Array, centre: Array) -> tuple[Float, NDArray[np.int64]]:
        """Depth (H, W) of the plane along unit rays (H, W, 3), NaN where it has no piece, and the piece's number."""
        depth, side = self.plane.depth(rays, centre), len(self.solid)
        number = np.zeros(depth.shape, np.int64)
        for axis in (self.across, self.down):
            along = (np.nan_to_num(depth) * (rays @ axis) + (centre - self.middle) @ axis) / self.edge
            index = np.floor(np.clip(along, -side, side)).astype(np.int64) + side // 2
            depth = np.where((index >= 0) & (index < side), depth, np.float32(np.nan))
            number = side * number + np.clip(index, 0, side - 1)
        return depth, number

    def depth(self, rays: Array, centre: Array) -> Float:
        """Depth (H, W) along unit rays (H, W, 3) from the centre (3,), NaN where they meet no solid piece."""
        depth, number = self.seen(rays, centre)
        return np.where(self.solid.ravel()[number], depth, np.float32(np.nan))


def solid_pieces(
    plane: Plane, depths: Float, T_wc: Array, rays: NDArray[np.floating], median_depth: float
) -> PlanePieces:
    """The pieces of a plane, by confirmed radial depths (K, H, W; NaN: none) of panoramas at poses (K, 4, 4).

    rays (H, W, 3): unit, of the camera. Pixels count alike, so that near and steep views have the most of them.
    """
    across, down = np.linalg.svd(plane.normal[None])[2][1:]
    centres = T_wc[:, :3, 3]
    edge, reach = EDGE * median_depth, FARTHEST * median_depth + float(np.ptp(centres, axis=0).max())
    side = 2 * int(np.ceil(reach / edge))
    pieces = PlanePieces(plane, across, down, centres.mean(axis=0), edge, np.zeros((side, side), bool))
    on, behind = np.zeros(side * side), np.zeros(side * side)
    for T, depth in zip(T_wc, depths):
        world = rays @ T[:3, :3].T
        expected, number = pieces.seen(world, T[:3, 3])
        off = (depth - expected) / depth * np.abs(world @ plane.normal)
        on += np.bincount(number[np.abs(off) < NEAR], minlength=side * side)
        behind += np.bincount(number[off > 2 * NEAR], minlength=side * side)
    undecided = np.ones((side, side), bool)
    for width in AROUND:
        there, through = (width**2 * cv2.blur(a.reshape(side, side), (width, width)) for a in (on, behind))
        decided = undecided & (there + through >= ENOUGH)
        pieces.solid[decided & (there > SHARE * through)] = True
        undecided &= ~decided
    return pieces

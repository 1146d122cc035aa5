"""Where a large plane of the scene explains the frames nearly as well as the depth at hand.

Where a surface has little texture, or shines, frames agree about as well on many depths, and the best of them means
little. But most large surfaces are flat (compare Gallup, Frahm and Pollefeys, "Piecewise planar and non-planar stereo
for urban scene reconstruction", 2010). So a plane need not be the best. What stands before it and has texture disagrees
there by more than it may, and stays where it is; behind a solid piece there is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.plane_matching import PlaneField, far_others
from panobench.bench.export.plane_pieces import NEAR, PlanePieces
from panobench.bench.export.posed_panoramas import PosedPanoramas

#: A plane is preferred where windows differ by at most this more on it, in luma of 1, than at the depth at hand, which
#: is nearer by less than this part.
ALLOWED, NEARER = 0.002, 0.05
#: Depth that other views confirm moves onto a plane by less than this part, unless the plane hides it.
SAME = 0.002


def preferred(
    views: PosedPanoramas,
    k: int,
    sure: NDArray[np.bool_],
    planes: Sequence[PlanePieces],
    finer: PosedPanoramas | None = None,
) -> NDArray[np.int16]:
    """(H, W): the number of the plane that view ``k`` shows in place of its depth, -1 for none.

    sure (H, W): where other views confirm the depth. finer: the same views larger, to be compared in their place.
    """
    depth, rays, T = views.depth[k], views.rays(k), views.T_wc[k]
    found = np.full(depth.shape, -1, np.int16)
    others = far_others(views, k)
    if not others:
        return found
    at_hand = PlaneField(views, k, others, finer=finer)
    at_hand.offer(views.scale.rays / depth[..., None])
    at_hand.offer_depth(depth)
    least, nearest = np.full(depth.shape, ALLOWED, np.float32), np.full(depth.shape, np.inf, np.float32)
    hiding = found.copy()
    made = depth.copy()
    for number, pieces in enumerate(planes):
        plane, there = pieces.plane, pieces.depth(rays, T[:3, 3])
        off = (depth - there) / depth * np.abs(rays @ plane.normal)
        behind = off > NEAR
        tried = ~behind & (~sure | (np.abs(off) < SAME)) & (there < (1 + NEARER) * depth)
        local = T[:3, :3].T @ plane.normal / (plane.offset - plane.normal @ T[:3, 3])
        field = PlaneField(views, k, others, finer=finer)
        field.offer(np.where(tried[..., None], local, np.nan))
        with np.errstate(invalid="ignore"):  # no frame shows some pixels
            excess = field.cost - at_hand.cost
        better = tried & (excess < least)
        found[better], least[better], made[better] = number, excess[better], there[better]
        hides = behind & (there < nearest)
        hiding[hides], nearest[hides] = number, there[hides]
    return np.where(nearest < made, hiding, found)

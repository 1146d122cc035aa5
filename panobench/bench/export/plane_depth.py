"""Depth of panoramas put right by the frames: flat where a plane explains them, where they agree best elsewhere.

Plain walls bulge in a map: nothing in their colour says where they are. For each pixel, the map's own depth and the
depths of all planes compete: by how well frames agree on each, by how far it is from the map's, and with their
neighbours of the same brightness. Costs are filtered by a guided filter and the least wins (Rhemann et al., "Fast
cost-volume filtering for visual correspondence and beyond", 2011; He et al., "Guided image filtering", 2010).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.depth_refinement import refined
from panobench.bench.export.plane_alignment import align
from panobench.bench.export.planes import Plane, find_planes
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera

Float = NDArray[np.float32]

#: A difference of luma (of 1) that costs one; no difference costs more than this.
UNIT, MOST = 0.02, 3.0
#: What it costs to lie on no plane.
FREE = 0.7
#: A plane whose depth differs from the map's by this part costs one, and one that differs by ``WIDEST`` is out.
NEAR, WIDEST = 0.1, 0.3
#: So large a part of a view's pixels on a plane must have a map's depth within ``SURE`` of it: a curved surface has
#: many tangents, and lies near each for a little way.
SUPPORT, SURE = 0.5, 0.02
#: Off the planes, depth at which the frames disagree by more than this is left out.
DOUBTED = 1.0
#: Of the guided filter: reach in pixels, and the variance of luma that it smooths over.
RADIUS, SMOOTHED = 8, 4e-4
#: The cost of what is impossible.
_NEVER = np.float32(9.0)


def corrected_depths(views: PosedPanoramas, depths: Float, seed: int = 0) -> Float:
    """Radial depths (K, h, w) of the map at the views' poses, put right by the frames; NaN where these contradict.

    On planes where planes explain the frames, elsewhere where the frames agree best near the map's depth.
    """
    generator = np.random.default_rng(seed)
    planes = [align(plane, views, generator) or plane for plane in find_planes(views, generator)]
    return np.stack([_corrected(views, k, planes, depth) for k, depth in enumerate(depths)])


def _corrected(views: PosedPanoramas, k: int, planes: Sequence[Plane], depth: Float) -> Float:
    if not views.others(k):
        return depth
    size = depth.shape[::-1]
    free = refined(views, k, views.depth[k])
    factor = np.where(_disagreement(views, k, free) < DOUBTED, free / views.depth[k], np.nan)
    factor[~views.scale.valid] = 1.0  # no frame says anything there
    made = depth * cv2.resize(factor.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
    chosen = cv2.resize(_choose(views, k, planes), size, interpolation=cv2.INTER_NEAREST)
    rays = ErpCamera(*size).rays() @ views.T_wc[k, :3, :3].T
    for number, plane in enumerate(planes):
        on_it = chosen == number
        made[on_it] = plane.depth(rays[on_it], views.T_wc[k, :3, 3])
    return made


def _choose(views: PosedPanoramas, k: int, planes: Sequence[Plane]) -> NDArray[np.int16]:
    """(H, W): the number of the plane on which each pixel lies, -1 for none."""
    mapped = views.depth[k]
    chosen = np.full(mapped.shape, -1, np.int16)
    guide, rays, centre = np.nan_to_num(views.luma[k]), views.rays(k), views.T_wc[k, :3, 3]
    least = _filtered(guide, _disagreement(views, k, mapped) + FREE)
    for number, plane in enumerate(planes):
        there = plane.depth(rays, centre)
        with np.errstate(invalid="ignore"):
            off = np.abs(np.log(there / mapped))
            possible = (off < WIDEST) & views.scale.valid  # not so where the plane is not ahead
        cost = _disagreement(views, k, there) + np.minimum(np.where(possible, off, 1.0) / NEAR, 1.0)
        cost = np.where(possible, _filtered(guide, np.where(possible, cost, _NEVER)), _NEVER)
        better = cost < least
        chosen[better], least = number, np.minimum(cost, least)
    for number, plane in enumerate(planes):
        on_it = chosen == number
        off = np.abs(np.log(plane.depth(rays[on_it], centre) / mapped[on_it]))
        if off.size and (off < SURE).mean() < SUPPORT:
            chosen[on_it] = -1
    return chosen


def _disagreement(views: PosedPanoramas, k: int, depth: Float) -> Float:
    return np.minimum(views.difference(k, depth) / UNIT, MOST)


def _filtered(guide: Float, cost: Float) -> Float:
    """The guided filter of a cost (H, W) by a luma (H, W), across the seam of the panorama."""
    reach = 2 * RADIUS
    I, p = (np.concatenate([a[:, -reach:], a, a[:, :reach]], axis=1).astype(np.float32) for a in (guide, cost))

    def mean(a: Float) -> Float:
        return np.asarray(cv2.blur(a, (2 * RADIUS + 1, 2 * RADIUS + 1)))

    mean_I, mean_p = mean(I), mean(p)
    slope = (mean(I * p) - mean_I * mean_p) / (mean(I * I) - mean_I**2 + SMOOTHED)
    base = mean_p - slope * mean_I
    return (mean(slope) * I + mean(base))[:, reach:-reach]

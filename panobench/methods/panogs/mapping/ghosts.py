"""Ghosts: what moved and got into the map all the same. Frames see through it, so it goes, and its hole is closed.

Nothing is trained where a frame contradicts the map (``transients``), and a swept depth replaces only what stands
before it. So somebody who stood in the first frames, or walked so slowly that frames agreed on her, may stay in the
room as a blur. Frames that lie further apart can tell.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.mapping.frame_votes import OFTEN, SAMPLE, FrameVotes
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.splatting.seeding import fill_depth
from panobench.methods.splatting.views import View
from panobench.splat.render import Render

Mask = NDArray[np.bool_]

#: Views that are asked, about; the fewest of them that must have an opinion on a Gaussian, and the weight in pixels
#: that they must see of it.
VIEWS, FEWEST, SEEN = 12, 4, 0.5
#: How often the views are asked, at most, and the steps of training in between: with a ghost gone, more of what it
#: stood among comes to light.
ROUNDS, STEPS = 3, 40
#: Share of the view that a hole must take to be closed.
HOLE = 1e-4


def remove_ghosts(mapper: Mapper, votes: FrameVotes) -> int:
    """Drop what the views see through and close the holes; how many Gaussians went."""
    views = sorted(mapper.optimiser.views(), key=lambda view: view.index)
    some, total = views[:: max(len(views) // VIEWS, 1)], 0
    for round_ in range(ROUNDS):
        gone = mapper.map.drop(ghosts_of(mapper, some, votes))
        if gone == 0:
            break
        total += gone
        for view in some:
            close_hole(mapper, view, votes)
        if round_ < ROUNDS - 1:
            mapper.optimiser.polish(STEPS)
    return total


def ghosts_of(mapper: Mapper, views: list[View], votes: FrameVotes) -> NDArray[np.bool_]:
    """(N,): Gaussians that enough of the views that have an opinion on them see through.

    A view has none where it contradicts the map otherwise: somebody stands there.
    """
    seen, against = np.zeros(len(mapper.map), np.int32), np.zeros(len(mapper.map), np.int32)
    for view in views:
        render = mapper.renderer.forward(mapper.map.gaussians, view.T_wc)
        contradicted = mapper.transients.contradicted(view.image, render, view.visible)
        through = contradicted & _seen_through(mapper, view, render, contradicted, votes)
        heard = through | ~contradicted
        if view.visible is not None:
            heard &= view.visible
        planes = np.stack([through, heard, np.ones_like(heard)]).astype(np.float32)
        in_through, in_heard, in_all = render.weighted_sums(planes).T
        told = (in_heard > SEEN) & (in_heard > 0.5 * in_all)
        seen += told
        against += told & (in_through > 0.5 * in_heard)
    return np.asarray((seen >= FEWEST) & (against > mapper.config.moving.seen_through * seen))


def _seen_through(mapper: Mapper, view: View, render: Render, where: Mask, votes: FrameVotes) -> Mask:
    """(H, W): where the map stands before what is around ``where`` (H, W), and few frames have shown it."""
    mapped = render.expected_depth(0.5)
    around = fill_depth(np.where(where, np.float32(np.nan), mapped), mapper.camera.kind == "erp")
    small, depth = votes.small(where.view(np.uint8)) > 0, votes.small(mapped)
    before = depth[small] < mapper.config.seeding.carve_depth * votes.small(around)[small]
    every = max(len(votes) // SAMPLE, 1)
    count = len(range(0, len(votes), every))
    drawn = votes.soft(np.ascontiguousarray(255 * render.colour))
    rarely = votes.count(view.T_wc, small, depth, drawn, every) < OFTEN * count
    return _at_size(small, before & rarely, where.shape)


def close_hole(mapper: Mapper, view: View, votes: FrameVotes) -> int:
    """New Gaussians where the map is thin in ``view``, as deep as what is around; how many.

    Only where enough frames show what the view does, for somebody may stand before the hole.
    """
    render = mapper.renderer.forward(mapper.map.gaussians, view.T_wc)
    thin = mapper.thin(render)
    if view.visible is not None:
        thin &= view.visible
    if mapper.weights[thin].sum() < HOLE:
        return 0
    depth_map = fill_depth(render.expected_depth(0.5), mapper.camera.kind == "erp")
    where = votes.small(cv2.dilate(thin.view(np.uint8), np.ones((5, 5), np.uint8))) > 0
    agree = votes.count(view.T_wc, where, votes.small(depth_map), votes.soft(view.image)) > OFTEN * len(votes)
    thin &= _at_size(where, agree, thin.shape)
    return mapper.seed(view, depth_map, *mapper.pattern.seeds(view.image, thin, mapper.rng))


def _at_size(where: Mask, values: Mask, shape: tuple[int, ...]) -> Mask:
    """``values`` (n,) of the pixels ``where`` (h, w), at the size ``shape`` (H, W); False elsewhere."""
    small = np.zeros(where.shape, np.uint8)
    small[where] = values
    return np.asarray(cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST) > 0)

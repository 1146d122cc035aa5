"""Occlusion culling from frame to frame: what was hidden a moment ago is left out, unless something has opened since.

In a building nearly all of a map stands behind walls, and drawing it costs more than drawing what is seen. As in a
hierarchical z-buffer with temporal coherence (Greene, Kass & Miller 1993), only what was visible last is drawn at
first. Where a doorway opens, none of that stands in it: pixels become transparent, and the whole map is drawn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panobench.methods.splatting.culling import VisibilityCulling
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.splat.gaussians import F32
from panobench.splat.render import Render, Renderer

#: Which Gaussians (N,) are left out; None: none is.
Hidden = NDArray[np.bool_] | None
#: Growth of the transparent share of the view at which the whole map is drawn.
OPENED = 0.002


class OccludedMap:
    """Draws a map from where the camera is now, mostly without what is hidden from there.

    trainable: the map. weights (H, W): of pixels, their sum is 1. least: pixels that a Gaussian must make up to count
    as visible, 0: the whole map is always drawn. opaque: opacity from which a pixel hides what is behind it.
    """

    def __init__(self, trainable: TrainableMap, weights: F32, least: float, opaque: float) -> None:
        self.map, self.weights, self.least, self.opaque = trainable, weights, least, opaque
        self.culling = VisibilityCulling()
        self.transparent = 0.0

    def follow(self, renderer: Renderer, T_wc: NDArray[np.float64]) -> Render:
        """The map at the newest pose, with sloped depth, touched pixels and weights; what is hidden is found anew."""

        def draw(hidden: Hidden) -> Render:
            weigh = self.least > 0
            return renderer.forward(
                self.map.gaussians, T_wc, count_touched=True, sum_weights=weigh, sloped=True, culled=hidden
            )

        render = self._without(self.culling.hidden(self.map.ids) if self.least else None, draw)
        if render is None:
            render = draw(None)
            if render.weights is not None:
                self.culling.update(self.map.ids, render.weights, self.least)
                self.transparent = self._transparent(render)
        return render

    def look(self, renderer: Renderer, T_wc: NDArray[np.float64], *, sloped: bool = False) -> Render:
        """The map at a pose near the newest one."""

        def draw(hidden: Hidden) -> Render:
            return renderer.forward(self.map.gaussians, T_wc, sloped=sloped, culled=hidden)

        return self._without(self.culling.unused_of(self.map.ids), draw) or draw(None)

    def _without(self, hidden: Hidden, draw: Callable[[Hidden], Render]) -> Render | None:
        """The map without what is hidden; None where something has opened, or where nothing is known to be hidden."""
        if hidden is None:
            return None
        render = draw(hidden)
        return render if self._transparent(render) < self.transparent + OPENED else None

    def _transparent(self, render: Render) -> float:
        """The share of the view that lets light through."""
        return float(self.weights[render.opacity < self.opaque].sum())

"""What moves by itself: where a frame contradicts the map over an area, nobody knows yet which of them is right.

A person who walks by contradicts a good map, and a map that has the person in it is contradicted once she has gone.
Neither is trained on. The frames that follow decide: what they all show at one depth is the scene and replaces the map,
and what they do not agree on is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.splat.gaussians import F32
from panobench.splat.loss import colour_error
from panobench.splat.render import Render

Mask = NDArray[np.bool_]

#: Pixels over which the error is averaged, and columns of the image per pixel of the narrowest area: edges that are off
#: by a pixel make lines, which are narrower.
_BLUR, _NARROWEST = 5, 48
#: Opacity from which the map knows a pixel, and pixels by which an area is widened.
_KNOWN, _WIDEN = 0.5, 2
#: Share of the error that counts at the border of an area.
_FAINT = 0.5
#: Frames running in which something must have moved: when the view opens into another room, a few look like it.
_FRAMES = 5


@dataclass
class Transients:
    """weights (H, W): of the loss, sum 1. error: mean colour error (of 1) from which a pixel contradicts the map.

    share: of the view that must have changed, in a few frames running, for anything to be left out. Until then,
    ``active`` is False and nothing is different.
    """

    weights: F32
    error: float
    share: float
    wrap: bool
    active: bool = False
    changed_for: int = 0

    def __post_init__(self) -> None:
        self._pad = self.weights.shape[1] // 16 if self.wrap else 0
        self._side = max(self.weights.shape[1] // _NARROWEST, 3)

    def look(
        self,
        image: NDArray[np.uint8],
        render: Render,
        moved: Callable[[Mask], float],
        visible: Mask | None = None,
    ) -> Mask | None:
        """(H, W): where a frame (H, W, 3) contradicts a render at its pose; None where nothing has moved so far.

        moved: which share of the view in a mask (H, W) has changed, and was not drawn wrong all along. visible (H, W):
        where the frame shows the scene; None: everywhere.
        """
        if not self.active and self.share < 1:
            core = self._unpadded(self._core(self._error(image, render), render, visible) > 0)
            changed = float(self.weights[core].sum()) > self.share and moved(core) > self.share
            self.changed_for = self.changed_for + 1 if changed else 0
            self.active = self.changed_for >= _FRAMES
        return self.contradicted(image, render, visible) if self.active else None

    def contradicted(self, image: NDArray[np.uint8], render: Render, visible: Mask | None = None) -> Mask:
        """(H, W): areas where image (H, W, 3) and render differ, a little widened; ``visible`` as in ``look``."""
        error = self._error(image, render)
        # What hides the scene has its colour here and there.
        core = cv2.morphologyEx(self._core(error, render, visible), cv2.MORPH_CLOSE, _square(2 * self._side + 1))
        near = (cv2.dilate(core, _square(self._side + 2 * _WIDEN)) > 0) & (error > _FAINT * self.error)
        found = (near | (core > 0)).astype(np.uint8)
        return self._unpadded(cv2.dilate(found, _square(2 * _WIDEN + 1)) > 0)

    def _error(self, image: NDArray[np.uint8], render: Render) -> F32:
        """Padded: mean colour error around each pixel."""
        return np.asarray(cv2.blur(self._padded(np.asarray(colour_error(render.planes, image))), (_BLUR, _BLUR)))

    def _core(self, error: F32, render: Render, visible: Mask | None) -> NDArray[np.uint8]:
        """Padded: where squares of the least width fit into what the map knows and draws wrong."""
        known = (render.opacity > _KNOWN) & (self.weights > 0)
        if visible is not None:  # what a frame's mask hides is black, and contradicts nothing
            known &= visible
        wrong = (error > self.error).astype(np.uint8) & self._padded(known.astype(np.uint8))
        return np.asarray(cv2.morphologyEx(wrong, cv2.MORPH_OPEN, _square(self._side)), dtype=np.uint8)

    def _padded(self, image: NDArray) -> NDArray:
        """A panorama with its columns repeated beyond both borders."""
        return np.concatenate([image[:, -self._pad :], image, image[:, : self._pad]], axis=1) if self._pad else image

    def _unpadded(self, image: Mask) -> Mask:
        return np.ascontiguousarray(image[:, self._pad : -self._pad]) if self._pad else image


def _square(side: int) -> NDArray[np.uint8]:
    return np.ones((side, side), np.uint8)

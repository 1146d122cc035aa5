"""Bringing frames to the map's exposure, so that nothing behind has to know of it.

The gain is the median, over blocks of the view, of the ratio of frame to render: an occluder or a lamp that goes on
spoils some blocks, not the median. Before tracking the render is that of the last frame, which will do because a turn
moves what a wide camera sees but hardly changes its median; after tracking it is of the same pose. Small gains are
left alone: frames of a camera with fixed exposure go through untouched.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.splat.gaussians import F32
from panobench.splat.render import Render

#: Blocks across the image; a block counts if it is known to the map and neither dark nor saturated.
_BLOCKS = 32
_KNOWN, _DARK, _SATURATED = 0.9, 0.06, 0.97
#: Fewest blocks that give a gain.
_ENOUGH = 24
#: Gains nearer to 1 are left alone: measured against the last frame's render, and against the frame's own.
BEFORE, AFTER = 0.04, 0.015
_RANGE = (0.2, 5.0)


Blocks = tuple[F32, NDArray[np.bool_]]


class ExposureGuard:
    """weights (H, W): of the loss. Does nothing for views that are not ``wide``: there a turn changes the median."""

    def __init__(self, weights: F32, wide: bool) -> None:
        self.wide = wide
        h, w = weights.shape
        self.size = (_BLOCKS, max(round(_BLOCKS * h / w), 1))
        self.weights = cv2.resize(weights, self.size, interpolation=cv2.INTER_AREA).ravel()
        self._last: Blocks | None = None

    def start(self, image: NDArray[np.uint8]) -> None:
        """This frame's exposure is the map's."""
        self._last = (self._luma(image), self.weights > 0)

    def before(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The frame for tracking, judged by the last frame's render (at first by the first frame)."""
        return image if self._last is None else self._corrected(image, self._last, BEFORE)

    def after(self, image: NDArray[np.uint8], render: Render) -> NDArray[np.uint8]:
        """The frame for mapping, judged by its own render, which the next frame will be judged by."""
        known = self._blocks(render.opacity) > _KNOWN
        self._last = (self._blocks(render.planes.mean(axis=0)), known & (self.weights > 0))
        return self._corrected(image, self._last, AFTER)

    def gain(self, image: NDArray[np.uint8], reference: Blocks) -> float:
        """Frame over reference; 1 if there is too little to compare."""
        frame, (drawn, known) = self._luma(image), reference
        usable = known & (np.minimum(frame, drawn) > _DARK) & (frame < _SATURATED)
        if np.count_nonzero(usable) < _ENOUGH:
            return 1.0
        ratio, weight = frame[usable] / drawn[usable], self.weights[usable]
        order = np.argsort(ratio)
        total = np.cumsum(weight[order])
        return float(np.clip(ratio[order][np.searchsorted(total, 0.5 * total[-1])], *_RANGE))

    def _corrected(self, image: NDArray[np.uint8], reference: Blocks, least: float) -> NDArray[np.uint8]:
        gain = self.gain(image, reference) if self.wide else 1.0
        if abs(np.log(gain)) < least:
            return image
        return np.asarray(cv2.convertScaleAbs(image, alpha=1.0 / gain))

    def _luma(self, image: NDArray[np.uint8]) -> F32:
        small = cv2.resize(image, self.size, interpolation=cv2.INTER_AREA)
        return np.asarray(small.mean(axis=2, dtype=np.float32).ravel() / np.float32(255))

    def _blocks(self, image: F32) -> F32:
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA).ravel())

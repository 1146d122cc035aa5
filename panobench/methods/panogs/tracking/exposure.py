"""Exposure matching: frames are brought to the map's exposure, so that nothing else has to model it.

The gain is the median, over blocks of the view, of the ratio of frame to render: an occluder or a lamp that goes on
spoils some blocks, not the median. Before tracking, the render is that of the last frame, which is good enough because
a rotation moves what a wide camera sees but hardly changes its median. After tracking it is of the same pose. Small
gains are left alone, so frames of a camera with fixed exposure stay untouched.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.config import ExposureOptions
from panobench.photometric.bands import DARK, SATURATED
from panobench.photometric.overlap import ViewWidth
from panobench.splat.gaussians import F32
from panobench.splat.render import Render

#: Blocks across the image; a block counts if it is known to the map and neither dark nor saturated.
_BLOCKS = 32
_KNOWN = 0.9
#: Fewest blocks that give a gain.
ENOUGH = 24
RANGE = (0.2, 5.0)
#: Standard deviation, in 8-bit levels, below which a frame shows nothing.
_BLANK_LEVELS = 1.0


Blocks = tuple[F32, NDArray[np.bool_]]


def is_blank(image: NDArray[np.uint8], valid: NDArray[np.bool_]) -> bool:
    """Nothing to align or to map: a closed shutter, a saturated sensor, fog. valid (H, W): the camera's view."""
    _, deviation = cv2.meanStdDev(image, mask=valid.view(np.uint8))
    return bool(deviation.max() < _BLANK_LEVELS)


class ExposureMatcher:
    """weights (H, W): of the loss. Leaves narrow views alone, because there a rotation changes the median."""

    def __init__(self, weights: F32, width: ViewWidth, options: ExposureOptions) -> None:
        self.enabled, self.options = options.match and width is ViewWidth.WIDE, options
        h, w = weights.shape
        self.size = (_BLOCKS, max(round(_BLOCKS * h / w), 1))
        self.weights = cv2.resize(weights, self.size, interpolation=cv2.INTER_AREA).ravel()
        self._last: Blocks | None = None

    def start(self, image: NDArray[np.uint8]) -> None:
        """This frame's exposure is the map's."""
        self._last = (self._luma(image), self.weights > 0)

    def before(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The frame for tracking, judged by the last frame's render (at first by the frame of the first map)."""
        return (
            image
            if self._last is None or not self.enabled
            else self._corrected(image, self._last, self.options.least_before)
        )

    def after(self, image: NDArray[np.uint8], render: Render) -> NDArray[np.uint8]:
        """The frame for mapping, judged by its own render, which the next frame will be judged by."""
        if not self.enabled:
            return image
        known = self._blocks(render.opacity) > _KNOWN
        self._last = (self._blocks(render.planes.mean(axis=0)), known & (self.weights > 0))
        return self._corrected(image, self._last, self.options.least_after)

    def gain(self, image: NDArray[np.uint8], reference: Blocks) -> float:
        """Frame over reference; 1 if there is too little to compare."""
        frame, (drawn, known) = self._luma(image), reference
        usable = known & (np.minimum(frame, drawn) > DARK) & (frame < SATURATED)
        if np.count_nonzero(usable) < ENOUGH:
            return 1.0
        return float(np.clip(weighted_median(frame[usable] / drawn[usable], self.weights[usable]), *RANGE))

    def _corrected(self, image: NDArray[np.uint8], reference: Blocks, least: float) -> NDArray[np.uint8]:
        return scaled(image, self.gain(image, reference), least)

    def _luma(self, image: NDArray[np.uint8]) -> F32:
        small = cv2.resize(image, self.size, interpolation=cv2.INTER_AREA)
        return np.asarray(small.mean(axis=2, dtype=np.float32).ravel() / np.float32(255))

    def _blocks(self, image: F32) -> F32:
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA).ravel())


def weighted_median(values: NDArray[np.float32], weights: NDArray[Any]) -> np.float32:
    """Of values (n,), at least one, with weights (n,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return np.float32(values[order][np.searchsorted(total, 0.5 * total[-1])])


def scaled(image: NDArray[np.uint8], gain: float, least: float) -> NDArray[np.uint8]:
    """An image (H, W, 3) without its gain, if the gain's logarithm is ``least`` or more."""
    if abs(np.log(gain)) < least:
        return image
    return np.asarray(cv2.convertScaleAbs(image, alpha=1.0 / gain))

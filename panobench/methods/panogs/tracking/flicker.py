"""Flicker: lamps on the mains change faster than a rolling shutter reads, and leave bands that wander over frames."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.tracking.exposure import DARK, SATURATED
from panobench.types import Frame

#: Standard deviation of the smoothing over rows, in rows of 256, and the fewest pixels that tell a row's gain.
SMOOTH, FEWEST = 6.0, 16


class Flicker:
    """Brings each row of a frame to the brightness that it had in the frame before, as that was handed on.

    A row's gain is the median over its pixels, which what moves changes little. Slow changes of what rows show are
    taken for gain as well, so this is for recordings that flicker.
    """

    def __init__(self, enabled: bool) -> None:
        self.enabled = enabled
        self._last: NDArray[np.float32] | None = None

    def steady(self, frame: Frame) -> Frame:
        """The frame without its bands; the first one stays as it is."""
        if not self.enabled:
            return frame
        image = frame.image
        if self._last is not None:
            gains = row_gains(self._luma(image), self._last)
            image = np.rint(np.clip(image / gains[:, None, None], 0, 255)).astype(np.uint8)
        self._last = self._luma(image)
        return replace(frame, image=image)

    @staticmethod
    def _luma(image: NDArray[np.uint8]) -> NDArray[np.float32]:
        return image.mean(axis=2, dtype=np.float32) / np.float32(255)


def row_gains(luma: NDArray[np.float32], before: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H,): brightness of the rows of ``luma`` (H, W, of 1) over those of ``before``, smooth over the rows."""
    usable = (np.minimum(luma, before) > DARK) & (np.maximum(luma, before) < SATURATED)
    logs = np.zeros(len(luma), np.float32)
    for row, known in enumerate(usable):
        if np.count_nonzero(known) >= FEWEST:
            logs[row] = np.log(np.median(luma[row, known] / before[row, known]))
    smooth = cv2.GaussianBlur(logs[:, None], (1, 0), sigmaX=1, sigmaY=SMOOTH * len(luma) / 256)
    return np.exp(smooth[:, 0])

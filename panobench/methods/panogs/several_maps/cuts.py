"""Cuts: where a recording goes on at another place. From one frame to the next a panorama changes its look evenly."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np

from panobench.cameras.base import Camera
from panobench.methods.panogs.factor_graph.place_recognition import WIDTH, Places, Thumbnail
from panobench.types import Frame

#: A cut changes the look by more than any of so many frames before it, whose least likeness it does not reach by this
#: factor: a camera that is fast, or of whose frames only some are used, always changes its look a lot.
FRAMES, FACTOR = 10, 0.6


class CutDetector:
    """Compares each frame with the one before it. alike: correlation of thumbnails below which there may be a cut.

    Views that do not see all the way round have no cuts: they may turn away.
    """

    def __init__(self, camera: Camera, alike: float) -> None:
        self.places, self.alike = Places(camera), alike
        self._index = -1
        self._last: Thumbnail | None = None
        self._usual: deque[float] = deque(maxlen=FRAMES)

    def look(self, frame: Frame) -> bool:
        """Whether the frame follows the last one in the sequence and shows another place."""
        if not self.places.circular:
            return False
        h, w = frame.image.shape[:2]
        small = cv2.resize(frame.image, (WIDTH, max(h * WIDTH // w, 1)), interpolation=cv2.INTER_AREA)
        before, follows = self._last, frame.index == self._index + 1
        self._index, self._last = frame.index, self.places.thumbnail(small.mean(axis=2, dtype=np.float32))
        if before is None or not follows:
            return False
        likeness = self.places.compare(before, self._last)[0][0]
        least = min(self._usual, default=0.0)
        self._usual.append(likeness)
        return likeness < min(self.alike, FACTOR * least)

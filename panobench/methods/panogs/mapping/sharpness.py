"""Motion blur: how sharp each frame is beside the others, so that the map learns little from those that are blurred.

A frame that the camera's motion has blurred is still aligned well, for its streaks lie evenly about where it was; but
the map would take them for the scene. A panorama sees the same rooms whichever way it turns, so that the share of fine
detail in its picture hardly changes while nothing is blurred.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.overlap import ViewWidth

Array = NDArray[np.float64]
#: The sharpest tenth of the frames says what sharp is, as soon as there are so many frames.
SHARP_PERCENTILE, FEWEST = 90.0, 10
#: Detail of a frame that has nothing to say, over that of a sharp one, and the share of its steps that it keeps.
BLUREST, LEAST_SHARE = 0.5, 0.05
#: A view of fewer steradians sees other things as it turns, and their detail says nothing of blur.
MOST_OF_THE_SPHERE = 2.5 * np.pi
#: Rows of a panorama that are left out at the top and the bottom, as a share: there, columns crowd.
POLES = 1 / 6


class Sharpness:
    """Detail of all frames so far, by index. below: of a sharp frame's detail, under which one counts as blurred."""

    def __init__(self, camera: Camera, below: float) -> None:
        self.below = below if ViewWidth.of(camera, MOST_OF_THE_SPHERE) is ViewWidth.WIDE else 0.0
        self._poles = int(camera.height * POLES) if camera.kind == "erp" else 0
        self._detail: dict[int, Array] = {}
        self._sharp: Array | None = None

    def look(self, index: int, image: NDArray[np.uint8]) -> None:
        """Take a frame's image (H, W, 3) as it came."""
        if self.below > 0:
            grey = cv2.cvtColor(image[self._poles : len(image) - self._poles], cv2.COLOR_RGB2GRAY)
            self._detail[index] = _detail(grey.astype(np.float32))
            self._sharp = None

    def share(self, index: int) -> float:
        """Of the steps that a sharp frame would get, 1 for one that is not blurred."""
        if index not in self._detail or len(self._detail) < FEWEST:
            return 1.0
        if self._sharp is None:
            self._sharp = np.percentile(list(self._detail.values()), SHARP_PERCENTILE, axis=0)
        relative = float((self._detail[index] / np.maximum(self._sharp, 1e-6)).min())
        if relative >= self.below:
            return 1.0
        return max((relative - BLUREST) / (self.below - BLUREST), 0.0) ** 2 * (1 - LEAST_SHARE) + LEAST_SHARE


def _detail(grey: NDArray[np.float32]) -> Array:
    """Energy of the derivatives (2,) across and down of an image (h, w), over that of the same image at half the size.

    Blur takes it from the finer image. Contrast, and what there is to see, change both.
    """
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    energies = [
        [float(np.square(a[:, 2:] - a[:, :-2]).mean()), float(np.square(a[2:] - a[:-2]).mean())] for a in (grey, half)
    ]
    return np.asarray(energies[0]) / np.maximum(energies[1], 1e-6)

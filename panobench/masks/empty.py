"""The part of a view that holds no picture: black in all frames, as beside a fisheye's image circle.

Nothing there can be tried by its motion, and it is no scene: to a method that takes it for one, half a panorama looks
like a whole one.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence

#: Frames looked at, and the brightest value (of 255) in any of them that is black.
FRAMES, BLACK = 12, 10
#: Smaller parts of the sphere are dark things, and more than this is a film that shows nothing.
LEAST, MOST = 0.01, 0.95
#: Pixels of 256 by which it is widened: compression blurs its border.
BORDER = 1.5


def empty_part(sequence: FrameSequence) -> NDArray[np.bool_]:
    """(H, W) at the camera's size. Raises what reading the sequence raises."""
    camera = sequence.camera
    seen, brightest = camera.valid_mask(), np.zeros((camera.height, camera.width), np.uint8)
    for index in np.unique(np.linspace(0, len(sequence) - 1, FRAMES).astype(int)):
        brightest = np.maximum(brightest, sequence.image(int(index)).max(axis=-1))
    black = cv2.morphologyEx((seen & (brightest <= BLACK)).view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    if not black.any():
        return np.zeros_like(seen)
    count, parts = cv2.connectedComponents(black)
    area = camera.with_mask(None).solid_angle() / (4 * np.pi)
    shares = np.bincount(parts.ravel(), area.ravel(), count)
    large = shares >= LEAST
    large[0] = False
    if shares[large].sum() > MOST * float(area[seen].sum()):
        return np.zeros_like(seen)
    size = 2 * round(BORDER * camera.width / 256) + 1
    return np.asarray(cv2.dilate(large[parts].view(np.uint8), np.ones((size, size), np.uint8)) > 0) & seen

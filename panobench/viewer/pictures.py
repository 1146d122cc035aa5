"""What viewers show of frames, renders and maps, and how much of it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera

#: Most points of a growing map, and widest pictures.
MAX_POINTS = 20_000
MAX_WIDTH = 512
#: Frames between two updates of what costs time: map, render, alignment of the truth.
PERIOD = 5


def small_camera(camera: Camera) -> Camera:
    """The camera at no more than ``MAX_WIDTH`` pixels of width."""
    step = camera.width_step
    return camera if camera.width <= MAX_WIDTH else camera.scaled(MAX_WIDTH // step * step)


def shrunk(image: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """An image at the size of ``small_camera``."""
    if image.shape[1] <= camera.width:
        return image
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def bytes_of(colours: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Colours 0..1 as bytes."""
    return (np.clip(colours, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)

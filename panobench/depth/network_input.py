"""A camera's image as the input of a network, whatever the camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.views import look_rotation, upright_rotation
from panobench.depth.network_description import NetworkInput


class NetworkView:
    """Reprojects images from a camera to the network's input; ``back`` is for its output, if that is a panorama."""

    def __init__(self, camera: Camera, d: NetworkInput) -> None:
        self.camera, self.d = camera, d
        self.valid = camera.valid_mask()
        self.there: Reprojector | None = None
        self.back: Reprojector | None = None
        if d.projection == "erp":
            panorama = ErpCamera(d.width, d.height)
            R = look_rotation(d.centre_deg) @ upright_rotation(camera)
            self.there = Reprojector(camera, panorama, R)
            self.back = Reprojector(panorama, camera, R.T, antialias=False)

    def network_image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The network's input as an RGB image (height, width, 3)."""
        if self.there is not None:
            return np.asarray(self.there.image(image), dtype=np.uint8)
        black = np.where(self.valid[..., None], image, np.uint8(0))
        return np.asarray(cv2.resize(black, (self.d.width, self.d.height), interpolation=cv2.INTER_AREA))


def normalised(image: NDArray[np.uint8], d: NetworkInput) -> NDArray[np.float32]:
    """The input tensor, (1, 3, h, w) or (1, h, w, 3) float32 as the description says."""
    x = image.astype(np.float32) * np.float32(d.range / 255.0)
    if d.colour == "bgr":
        x = x[..., ::-1]
    x = (x - np.array(d.mean, np.float32)) / np.array(d.std, np.float32)
    x = x.transpose(2, 0, 1) if d.layout == "nchw" else x
    return np.ascontiguousarray(x[None], dtype=np.float32)

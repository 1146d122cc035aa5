"""How pixels continue across an image's borders, so that interpolation neither bleeds nor breaks there.

A ``Seams`` pads an image by what really lies beyond its borders and says where a pixel coordinate lands in the
padded image. For most cameras nothing lies there and coordinates are clamped to the outermost pixel centres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Array

if TYPE_CHECKING:
    from panobench.cameras.cubemap import CubemapCamera

Image = NDArray[Any]


class Seams:
    """The default: the image ends at its border."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height

    def pad(self, image: Image) -> Image:
        """Image (H, W[, C]) -> padded image, same type."""
        return image

    def locate(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Pixel coordinates (centres at k + 0.5) -> column and row in the padded image (centres at k)."""
        return np.clip(u - 0.5, 0, self.width - 1), np.clip(v - 0.5, 0, self.height - 1)


class PanoramaSeams(Seams):
    """A full panorama: columns wrap around; beyond a pole lies the same row, half a turn away."""

    def pad(self, image: Image) -> Image:
        h, w = self.height, self.width
        out = np.empty((h + 2, w + 2, *image.shape[2:]), image.dtype)
        out[1:-1, 1:-1] = image
        half = w // 2
        for row, source in ((0, 0), (h + 1, h - 1)):
            out[row, 1 : half + 1] = image[source, w - half :]
            out[row, half + 1 : w + 1] = image[source, : w - half]
        out[:, 0] = out[:, w]
        out[:, w + 1] = out[:, 1]
        return out

    def locate(self, u: Array, v: Array) -> tuple[Array, Array]:
        return u % self.width + 0.5, np.clip(v, 0, self.height) + 0.5


class CubemapSeams(Seams):
    """A strip of faces: each is framed by one pixel of its true neighbours on the cube."""

    def __init__(self, camera: CubemapCamera) -> None:
        super().__init__(camera.width, camera.height)
        n = camera.height
        k = np.arange(n + 2) - 0.5  # centres of a framed face, in the face's own pixels
        a, b = np.meshgrid(2 * k / n - 1, 2 * k / n - 1)
        q = np.stack([a, b, np.ones_like(a)], axis=-1)
        frame = (np.abs(a) > 1) | (np.abs(b) > 1)
        self._framed: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        rows, columns = np.nonzero(frame)
        self._frame = rows, columns
        for R in camera.rotations:
            pixels, _ = camera.project(q[frame] @ R)
            self._framed.append((pixels[:, 1].astype(np.intp), pixels[:, 0].astype(np.intp)))

    def pad(self, image: Image) -> Image:
        n = self.height
        out = np.empty((n + 2, 6 * (n + 2), *image.shape[2:]), image.dtype)
        for face, (v, u) in enumerate(self._framed):
            part = out[:, face * (n + 2) : (face + 1) * (n + 2)]
            part[1:-1, 1:-1] = image[:, face * n : (face + 1) * n]
            part[self._frame] = image[v, u]
        return out

    def locate(self, u: Array, v: Array) -> tuple[Array, Array]:
        n = self.height
        face = np.clip(u // n, 0, 5)
        return u + 2 * face + 0.5, np.clip(v, 0, n) + 0.5

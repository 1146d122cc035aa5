"""How an image continues across its borders, so that interpolation there uses the true neighbours.

A ``Seams`` maps pixel coordinates to a padded image, which has the true neighbours beyond the borders, and cuts the
needed part out of it. The images of most cameras end at their borders.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Array

if TYPE_CHECKING:
    from panobench.cameras.cubemap import CubemapCamera

Image = NDArray[Any]
Array32 = NDArray[np.float32]


class Window(NamedTuple):
    """Columns x0 to x1 - 1 and rows y0 to y1 - 1 of the padded image."""

    x0: int
    x1: int
    y0: int
    y1: int


class Seams:
    """The default: the image ends at its border, and nothing is padded."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height

    def locate(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Column and row in the padded image (centres at k) of pixel coordinates (centres at k + 0.5)."""
        return np.clip(u - 0.5, 0, self.width - 1), np.clip(v - 0.5, 0, self.height - 1)

    def window(self, x: Array32, y: Array32, used: NDArray[np.bool_]) -> Window:
        """The part of the padded image that interpolation at the ``used`` positions needs.

        A panorama may add whole widths to ``x``, in place.
        """
        if not used.any():
            return Window(0, 1, 0, 1)
        x0, y0 = int(np.floor(x[used].min())), int(np.floor(y[used].min()))
        return Window(x0, int(np.ceil(x[used].max())) + 1, y0, int(np.ceil(y[used].max())) + 1)

    def cut(self, image: Image, window: Window) -> Image:
        """The part of the padded ``image`` (H, W[, C]) in the window; a view if it has no padding."""
        return image[window.y0 : window.y1, window.x0 : window.x1]


class PanoramaSeams(Seams):
    """A full panorama: columns wrap around, and beyond a pole the same row continues 180 degrees away."""

    def locate(self, u: Array, v: Array) -> tuple[Array, Array]:
        return u % self.width + 0.5, np.clip(v, 0, self.height) + 0.5

    def window(self, x: Array32, y: Array32, used: NDArray[np.bool_]) -> Window:
        """As ``Seams.window``; it starts after the widest gap, so that views across the seam stay small."""
        if not used.any():
            return Window(0, 1, 0, 1)
        columns = np.flatnonzero(np.bincount(x[used].astype(np.intp) % self.width, minlength=self.width))
        gaps = np.diff([*columns, columns[0] + self.width])
        start = columns[(int(np.argmax(gaps)) + 1) % len(columns)]
        x[used & (x < start)] += self.width
        return super().window(x, y, used)

    def cut(self, image: Image, window: Window) -> Image:
        h, w = self.height, self.width
        x0, x1, y0, y1 = window
        if x0 >= 1 and x1 <= w + 1 and y0 >= 1 and y1 <= h + 1:
            return image[y0 - 1 : y1 - 1, x0 - 1 : x1 - 1]
        out = np.empty((y1 - y0, x1 - x0, *image.shape[2:]), image.dtype)
        top, bottom = max(y0, 1), min(y1, h + 1)
        _copy_wrapped(out[top - y0 : bottom - y0], image[top - 1 : bottom - 1], x0 - 1)
        if y0 == 0:
            _copy_wrapped(out[:1], image[:1], x0 - 1 + w // 2)
        if y1 == h + 2:
            _copy_wrapped(out[-1:], image[-1:], x0 - 1 + w // 2)
        return out


def _copy_wrapped(out: Image, image: Image, start: int) -> None:
    """Fill ``out`` with the columns of ``image`` from ``start`` on, around the panorama."""
    width, done = image.shape[1], 0
    while done < out.shape[1]:
        column = (start + done) % width
        n = min(width - column, out.shape[1] - done)
        out[:, done : done + n] = image[:, column : column + n]
        done += n


class CubemapSeams(Seams):
    """A strip of faces, each with a border of one pixel from its true neighbours on the cube."""

    def __init__(self, camera: CubemapCamera) -> None:
        super().__init__(camera.width, camera.height)
        n = camera.height
        k = np.arange(n + 2) - 0.5  # centres of a face with its border, in the face's own pixels
        a, b = np.meshgrid(2 * k / n - 1, 2 * k / n - 1)
        q = np.stack([a, b, np.ones_like(a)], axis=-1)
        frame = (np.abs(a) > 1) | (np.abs(b) > 1)
        self._framed: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        rows, columns = np.nonzero(frame)
        self._frame = rows, columns
        for R in camera.rotations:
            pixels, _ = camera.project(q[frame] @ R)
            self._framed.append((pixels[:, 1].astype(np.intp), pixels[:, 0].astype(np.intp)))

    def cut(self, image: Image, window: Window) -> Image:
        return super().cut(self._pad(image), window)

    def _pad(self, image: Image) -> Image:
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

"""Small panoramas on which directions are compared: filters and shifts of equal angles at all latitudes."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera

Image = NDArray[np.float32]

#: Rows near a pole are stretched by at most this.
MOST_STRETCH = 12.0
#: Rows whose windows differ by less than this share are filtered together.
_ALIKE = 0.12
#: Differences of normalised values above this are all the same: not the same thing.
TRUNCATED = 1.5
#: Grey levels of contrast that are taken for noise.
NOISE = 8.0


class Panorama:
    """The pixel grid of a full panorama ``width`` pixels wide. Sizes and shifts are in pixels at the equator."""

    def __init__(self, width: int) -> None:
        self.width, self.height = width, width // 2
        self.camera = ErpCamera(self.width, self.height)
        self.rays = np.ascontiguousarray(self.camera.rays())
        #: Share of the sphere that each pixel covers.
        self.area = self.camera.solid_angle() / (4 * np.pi)
        self.pixels_per_radian = width / (2 * np.pi)
        latitude = (0.5 - (np.arange(self.height) + 0.5) / self.height) * np.pi
        self._stretch = np.minimum(1 / np.cos(latitude), MOST_STRETCH)
        self._bands: dict[float, list[tuple[int, int, int]]] = {}

    def beyond_poles(self, x: NDArray[Any], rows: int) -> NDArray[Any]:
        """(H, W[, C]) with ``rows`` more at either pole: there the panorama goes on on the opposite meridian."""
        half = self.width // 2
        return np.concatenate([np.roll(x[:rows][::-1], half, axis=1), x, np.roll(x[-rows:][::-1], half, axis=1)])

    def mean(self, x: Image, size: int) -> Image:
        """Means over windows of ``size`` pixels a side, (H, W[, C])."""
        out = np.empty_like(x)
        for first, last, columns in self._window_bands(size):
            pad = columns // 2
            rows = x[first:last]
            if pad:
                rows = np.concatenate([rows[:, -pad:], rows, rows[:, :pad]], axis=1)
            out[first:last] = cv2.blur(rows, (columns, 1))[:, pad : pad + self.width]
        pad = size // 2 + 1
        return np.asarray(cv2.blur(self.beyond_poles(out, pad), (1, size))[pad:-pad], dtype=np.float32)

    def _window_bands(self, size: int) -> list[tuple[int, int, int]]:
        """(first row, last row, odd number of columns) of the rows that are filtered together."""
        if size not in self._bands:
            bands: list[tuple[int, int, int]] = []
            first = 0
            while first < self.height:
                here = self._stretch[first]
                last = first + 1
                while last < self.height and abs(self._stretch[last] / here - 1) < _ALIKE:
                    last += 1
                columns = size * float(self._stretch[first:last].mean())
                bands.append((first, last, min(2 * round((columns - 1) / 2) + 1, self.width // 2 * 2 - 1)))
                first = last
            self._bands[size] = bands
        return self._bands[size]

    def at(self, x: Image, directions: NDArray[Any]) -> Image:
        """Values of ``x`` (H, W[, C]) along directions (..., 3) of any length, bilinear."""
        d = np.asarray(directions, dtype=np.float32)
        across = np.sqrt(d[..., 0] ** 2 + d[..., 2] ** 2)
        u = np.arctan2(d[..., 0], d[..., 2]) * np.float32(self.width / (2 * np.pi)) + np.float32(0.5 * self.width + 0.5)
        v = np.arctan2(d[..., 1], across) * np.float32(self.height / np.pi) + np.float32(0.5 * self.height + 0.5)
        padded = self.beyond_poles(x, 1)
        padded = np.concatenate([padded[:, -1:], padded, padded[:, :1]], axis=1)
        return np.asarray(cv2.remap(padded, u, v, cv2.INTER_LINEAR))

    @cached_property
    def _grid(self) -> tuple[Image, Image]:
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float32), np.arange(self.height, dtype=np.float32))
        return u, v

    def shifted(self, x: Image, dx: float, dy: float) -> Image:
        """``x`` (H, W, C) as seen dx pixels to the right and dy down of each pixel."""
        rows, columns = int(abs(dy)) + 2, int(abs(dx) * MOST_STRETCH) + 2
        padded = self.beyond_poles(x, rows)
        padded = np.concatenate([padded[:, -columns:], padded, padded[:, :columns]], axis=1)
        u, v = self._grid
        u = u + columns + np.float32(dx) * self._stretch.astype(np.float32)[:, None]
        return np.asarray(cv2.remap(padded, u, v + np.float32(rows + dy), cv2.INTER_LINEAR))

    def normalised(self, image: Image) -> Image:
        """RGB (H, W, 3), 0..255, without its local mean and over its local contrast: exposure drops out."""
        smooth = self.mean(image, 3)
        detail = smooth - self.mean(smooth, 13)
        contrast = np.sqrt(np.maximum(self.mean(np.square(detail).mean(axis=-1), 13), 0.0))
        return np.asarray(detail / (contrast[..., None] + NOISE), dtype=np.float32)

    def difference(self, a: Image, b: Image, size: int = 5) -> Image:
        """(H, W): mean difference of normalised images over windows, each at most ``TRUNCATED``."""
        d = cv2.absdiff(a, b)
        return self.mean(np.minimum((d[..., 0] + d[..., 1] + d[..., 2]) / 3, TRUNCATED), size)

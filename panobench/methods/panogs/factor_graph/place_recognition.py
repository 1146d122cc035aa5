"""Place recognition by thumbnails: how alike two views are, and the yaw between them.

On a panorama that sees all the way round, a yaw is a shift of columns. The correlation over all shifts comes from the
rows' spectra (the convolution theorem), weighted by cos(latitude). Each row's mean is left out, because bright ceilings
over dark floors are in every room. Other views are compared as they are, without a yaw.

Where a mask leaves gaps in the rows, as that of a rig's lenses does, what is left of them still shows the yaw: gaps get
their row's mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.pyramid import F32

#: Size of a thumbnail's longer side.
WIDTH = 64
#: Places whose scores are worked out together.
_BATCH = 256


#: Spectra of the rows (h, WIDTH / 2 + 1), or the picture itself (h, WIDTH) where yaws are not looked for.
Thumbnail = NDArray[np.complex64] | NDArray[np.float32]


@dataclass(frozen=True)
class Match:
    """Place ``number``, its likeness (-1..1) and the yaw (radians, to the right) from its view to the asked one."""

    number: int
    score: float
    yaw: float


class Places:
    """Thumbnails by number, in the order they were added: 8 KiB each for a full panorama.

    gaps: whether yaws are looked for in a panorama with gaps in its rows, too.
    """

    def __init__(self, camera: Camera, *, gaps: bool = False) -> None:
        valid = camera.valid_mask()
        self._size = (WIDTH, max(round(WIDTH * camera.height / camera.width), 4))
        seen = cv2.resize(valid.astype(np.float32), self._size, interpolation=cv2.INTER_AREA) > 0.99
        whole = bool((valid.all(axis=1) | ~valid.any(axis=1)).all())
        self.circular, self._gaps = camera.kind == "erp" and (whole or gaps), not whole
        weights = cv2.resize(camera.solid_angle().astype(np.float32), self._size, interpolation=cv2.INTER_AREA)
        self._weights = np.where(seen, np.nan_to_num(weights), 0.0)
        self._spectra = np.zeros((0, *self._shape), np.complex64 if self.circular else np.float32)
        self.count = 0

    @property
    def _shape(self) -> tuple[int, int]:
        return (self._size[1], WIDTH // 2 + 1 if self.circular else WIDTH)

    @property
    def nbytes(self) -> int:
        return self._spectra.nbytes

    def thumbnail(self, luma: F32) -> Thumbnail:
        """What is kept of a view: from luma (h, w) of any size, NaN where unknown."""
        small = cv2.resize(np.nan_to_num(luma), self._size, interpolation=cv2.INTER_AREA)
        w = self._weights
        if self.circular:
            if self._gaps:
                means = np.sum(small * (w > 0), axis=1) / np.maximum(np.sum(w > 0, axis=1), 1)
                small -= means[:, None].astype(np.float32)
            spectrum = np.fft.rfft(small * np.sqrt(w), axis=1)
            spectrum[:, 0] = 0.0
            return (spectrum / max(_norm(spectrum), 1e-12)).astype(np.complex64)
        small = (small - np.sum(w * small) / max(float(w.sum()), 1e-12)) * np.sqrt(w)
        return (small / max(float(np.linalg.norm(small)), 1e-12)).astype(np.float32)

    def add(self, thumbnail: Thumbnail) -> int:
        """Remember a place; returns its number."""
        if self.count == len(self._spectra):
            more = np.zeros((max(64, self.count // 2), *self._shape), self._spectra.dtype)
            self._spectra = np.concatenate([self._spectra, more])
        self._spectra[self.count] = thumbnail
        self.count += 1
        return self.count - 1

    def extend(self, other: Places, numbers: list[int]) -> None:
        """Remember these of another one's places."""
        for n in numbers:
            self.add(other._spectra[n])

    def find(self, thumbnail: Thumbnail, count: int = 5, among: NDArray[np.bool_] | None = None) -> list[Match]:
        """The ``count`` most alike places, best first; ``among`` (N,): only these."""
        numbers = np.arange(self.count) if among is None else np.flatnonzero(among[: self.count])
        matches: list[Match] = []
        for first in range(0, len(numbers), _BATCH):
            part = numbers[first : first + _BATCH]
            matches += [Match(int(n), *sy) for n, sy in zip(part, self._compare(self._spectra[part], thumbnail))]
        return sorted(matches, key=lambda m: -m.score)[:count]

    def compare(self, one: Thumbnail, other: Thumbnail, peaks: int = 1) -> list[tuple[float, float]]:
        """Likeness and yaw from ``one`` to ``other`` at the best ``peaks`` maxima, best first."""
        if not self.circular:
            return self._compare(one[None], other)
        return _peaks(self._curves(one[None], other)[0], peaks)

    def _compare(self, kept: Thumbnail, asked: Thumbnail) -> list[tuple[float, float]]:
        if not self.circular:
            return [(float(s), 0.0) for s in np.tensordot(kept, asked, 2)]
        return [_peaks(curve, 1)[0] for curve in self._curves(kept, asked)]

    def _curves(self, kept: Thumbnail, asked: Thumbnail) -> NDArray[np.float64]:
        """(N, WIDTH): correlation by columns that what was kept must move to the left to become what is asked."""
        product = np.einsum("nrk,rk->nk", kept, np.conj(asked))
        return np.fft.irfft(product, n=WIDTH, axis=1) * WIDTH


def _norm(spectrum: NDArray[np.complex128]) -> float:
    """Such that a view's correlation with itself is 1: the inner columns of a half spectrum count twice."""
    power = np.abs(spectrum) ** 2
    return float(np.sqrt(2 * power[:, 1:-1].sum() + power[:, 0].sum() + power[:, -1].sum()))


def _peaks(curve: NDArray[np.float64], count: int) -> list[tuple[float, float]]:
    """Maxima of a periodic curve, refined by a parabola: (height, position in radians within -pi..pi)."""
    before, after = np.roll(curve, 1), np.roll(curve, -1)
    tops = np.flatnonzero((curve >= before) & (curve > after))
    if len(tops) == 0:
        return [(float(curve.max()), 0.0)]
    tops = tops[np.argsort(-curve[tops], kind="stable")][:count]
    out = []
    for k in tops:
        bend = before[k] - 2 * curve[k] + after[k]
        shift = 0.5 * (before[k] - after[k]) / bend if bend < 0 else 0.0
        yaw = 2 * np.pi * (k + shift) / len(curve)
        height = curve[k] - 0.25 * (before[k] - after[k]) * shift
        out.append((float(height), float((yaw + np.pi) % (2 * np.pi) - np.pi)))
    return out


def yawed(T_wc: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """The pose T_wc (4, 4) after a yaw of the camera to the right, about its own y axis, in radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    Ry = np.eye(4)
    Ry[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
    return np.asarray(T_wc @ Ry)

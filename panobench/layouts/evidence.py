"""What a picture itself tells of how it holds the sphere: where it would be torn if it held it in a given way.

Directions that are close together look alike. A packing puts most of them close together in the picture, too, and tears
some apart: a panorama at its seam and its poles, a cubemap along its edges. In a picture that is packed so, torn pairs
are as alike as the others; in any other picture they are as unlike as any two places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.layouts.cells import Packing

Array = NDArray[np.float64]
#: Pairs of directions looked at, and the angle between them.
_PAIRS = 40_000
_APART_DEG = 2.5
#: Pixels darker than this, everywhere, are no picture: bars, the outside of circles.
_DARK = 20
#: Standard deviation of a part of one colour, as codecs leave it at the edges.
_EVEN = 12.0


@dataclass(frozen=True)
class Tear:
    """ratio: how unlike torn pairs are, beside pairs that are not torn; far: the same for places that have nothing to
    do with each other. pairs: how many were torn.
    """

    ratio: float
    far: float
    pairs: int


def tear(image: NDArray[np.uint8], packing: Packing, *, within_deg: float = 90.0, seed: int = 0) -> Tear | None:
    """How a picture (H, W, 3) looks where ``packing`` tears it; None where it is too plain to tell.

    within_deg: of torn pairs, those that are no higher above or below the horizon than this count.
    """
    rng = np.random.default_rng(seed)
    first = _directions(rng, _PAIRS)
    across = np.cross(first, _directions(rng, _PAIRS))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    angle = np.deg2rad(_APART_DEG)
    second = first * np.cos(angle) + across * np.sin(angle)
    a, in_a = packing.locate(first)
    b, in_b = packing.locate(second)
    seen = in_a & in_b
    if seen.sum() < 1000:
        return None
    a, b, level = a[seen], b[seen], np.abs(first[seen, 1]) <= np.sin(np.deg2rad(within_deg))
    height, width = image.shape[:2]
    step = np.hypot((a - b)[:, 0] * width, (a - b)[:, 1] * height)
    grey = _smooth(image)
    difference = np.abs(_sample(grey, a) - _sample(grey, b))
    usual = float(np.median(step))
    torn, whole = (step > 6 * usual) & level, step < 1.5 * usual
    strangers = np.abs(_sample(grey, a) - _sample(grey, rng.permutation(a)))
    base = float(difference[whole].mean())
    if torn.sum() < 100 or float(strangers.mean()) < 2 * base or base <= 0:
        return None
    return Tear(float(difference[torn].mean()) / base, float(strangers.mean()) / base, int(torn.sum()))


def _directions(rng: np.random.Generator, count: int) -> Array:
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _smooth(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Grey, without noise and fine texture."""
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), max(1.0, image.shape[1] / 400)))


def _sample(grey: NDArray[np.float32], place: Array) -> NDArray[np.float32]:
    h, w = grey.shape
    x = np.clip((place[:, 0] * w).astype(int), 0, w - 1)
    y = np.clip((place[:, 1] * h).astype(int), 0, h - 1)
    return grey[y, x]


def alike(image: NDArray[np.uint8], where: str) -> float:
    """Correlation of the two halves of a picture, "beside" or "above" each other, -1 to 1; shifts of a few percent (the
    eyes' parallax) are allowed for.
    """
    import cv2

    small = cv2.resize(_smooth(image), (128, 128), interpolation=cv2.INTER_AREA)
    first, second = (small[:, :64], small[:, 64:]) if where == "beside" else (small[:64], small[64:])
    best = -1.0
    for shift in range(-3, 4):
        a = first[:, max(0, shift) : first.shape[1] + min(0, shift)]
        b = second[:, max(0, -shift) : second.shape[1] + min(0, -shift)]
        a, b = a - a.mean(), b - b.mean()
        scale = float(np.sqrt((a * a).sum() * (b * b).sum()))
        best = max(best, float((a * b).sum()) / scale if scale > 0 else -1.0)
    return best


def outside_circles(image: NDArray[np.uint8]) -> float:
    """Share of the pixels outside the circles in a picture's halves that are dark; 0 where the circles are, too."""
    h, w = image.shape[:2]
    half = w // 2
    y, x = np.mgrid[0:h, 0:half]
    radius = np.hypot((x + 0.5) / half - 0.5, (y + 0.5) / h - 0.5)
    value = image[:, : 2 * half].max(axis=-1).reshape(h, 2, half).transpose(1, 0, 2)
    dark = value < _DARK
    inside = float(dark[:, radius < 0.4].mean())
    return 0.0 if inside > 0.5 else float(dark[:, radius > 0.53].mean())


def vacant(image: NDArray[np.uint8], cells: Sequence[Sequence[object]]) -> bool:
    """Whether the cells of a picture's grid that hold nothing (None) are of one colour."""
    h, w = image.shape[:2]
    for row, line in enumerate(cells):
        for column, cell in enumerate(line):
            rows = slice(row * h // len(cells), (row + 1) * h // len(cells))
            part = image[rows, column * w // len(line) : (column + 1) * w // len(line)]
            if cell is None and part.size and float(part.std(axis=(0, 1)).max()) > _EVEN:
                return False
    return True


def bars(images: Sequence[NDArray[np.uint8]]) -> tuple[float, float, float, float]:
    """The part of pictures of one size that is within no dark bar along an edge: left, top, right, bottom, 0..1."""
    brightest = np.max([image.max(axis=-1) for image in images], axis=0)
    lit = brightest >= _DARK
    rows, columns = lit.mean(axis=1) > 0.1, lit.mean(axis=0) > 0.1  # codecs leave ripples along the edge
    if not rows.any():
        return (0.0, 0.0, 1.0, 1.0)
    top, bottom = int(np.argmax(rows)), len(rows) - int(np.argmax(rows[::-1]))
    left, right = int(np.argmax(columns)), len(columns) - int(np.argmax(columns[::-1]))
    return left / len(columns), top / len(rows), right / len(columns), bottom / len(rows)

"""Binary descriptors of tangent-plane templates, for loop closure and relocalisation.

Rotated BRIEF (Rublee et al., ORB, ICCV 2011) on the templates that the map stores anyway: orientation by the intensity
centroid, 128 comparisons on each of two pyramid levels. Templates are cut from the tangent plane of a bearing, so a
point looks the same wherever it lies in a panorama.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import njit
from panobench.methods.sparse.patches import STORED

#: Comparisons per level; two levels fill 32 bytes.
TESTS = 128
BYTES = 2 * TESTS // 8


def _pattern() -> NDArray[np.float64]:
    """Pairs of points (2, TESTS, 4) in template pixels from the centre; rotated ones stay inside the template."""
    rng = np.random.default_rng(20160101)
    p = rng.normal(0, STORED / 5, (2, TESTS * 4, 4))
    inside = (np.hypot(p[..., 0], p[..., 1]) < 6.5) & (np.hypot(p[..., 2], p[..., 3]) < 6.5)
    apart = np.hypot(p[..., 0] - p[..., 2], p[..., 1] - p[..., 3]) > 2.0
    return np.stack([q[k][:TESTS] for q, k in zip(p, inside & apart)])


PATTERN = _pattern()


@njit(cache=True)
def _smooth(patch, x, y):  # type: ignore[no-untyped-def]
    """Sum of the 3x3 pixels around (x, y), which is relative to the centre."""
    i, j = int(y + STORED / 2), int(x + STORED / 2)
    i, j = min(max(i, 1), STORED - 2), min(max(j, 1), STORED - 2)
    s = 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            s += patch[i + a, j + b]
    return s


@njit(cache=True, nogil=True)
def _describe(templates, levels, pattern, out):  # type: ignore[no-untyped-def]
    tests = pattern.shape[1]
    for n in range(len(templates)):
        mx, my = 0.0, 0.0
        oriented = templates[n, levels[1]]
        for i in range(STORED):
            for j in range(STORED):
                x, y = j - STORED / 2 + 0.5, i - STORED / 2 + 0.5
                if x * x + y * y < 49.0:
                    mx += x * oriented[i, j]
                    my += y * oriented[i, j]
        norm = math.sqrt(mx * mx + my * my) + 1e-12
        c, s = mx / norm, my / norm
        for half in range(2):
            patch = templates[n, levels[half]]
            for k in range(tests):
                p = pattern[half, k]
                a = _smooth(patch, c * p[0] - s * p[1], s * p[0] + c * p[1])
                b = _smooth(patch, c * p[2] - s * p[3], s * p[2] + c * p[3])
                if a < b:
                    bit = half * tests + k
                    out[n, bit >> 3] |= np.uint8(1 << (bit & 7))


def describe(templates: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Templates (N, levels, 16, 16) -> descriptors (N, 32)."""
    levels = templates.shape[1]
    out = np.zeros((len(templates), BYTES), np.uint8)
    _describe(templates, (min(1, levels - 1), min(2, levels - 1)), PATTERN, out)
    return out


def match(
    a: NDArray[np.uint8], b: NDArray[np.uint8], farthest: int = 64, ratio: float = 0.85
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Mutual nearest neighbours by Hamming distance that pass the ratio test: indices into a and b."""
    none = np.empty(0, np.int64)
    if len(a) == 0 or len(b) < 2:
        return none, none
    near = cv2.batchDistance(a, b, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    distance, index = near[0], near[1]
    back = cv2.batchDistance(b, a, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)[1][:, 0]
    i = np.arange(len(a))
    good = (distance[:, 0] <= farthest) & (distance[:, 0] < ratio * distance[:, 1]) & (back[index[:, 0]] == i)
    return i[good], index[good, 0].astype(np.int64)

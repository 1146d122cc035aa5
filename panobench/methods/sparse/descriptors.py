"""Binary descriptors of tangent-plane templates, for loop closure and relocalisation.

Rotated BRIEF (Rublee et al., ORB, ICCV 2011) on the templates that the map stores anyway: orientation by the intensity
centroid, 128 comparisons on each of two pyramid levels. Templates are cut from the tangent plane of a bearing, so a
point looks the same wherever it lies in a panorama.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import JIT, njit
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


@njit(**JIT)
def _nearest(a, b, first, second, index, back_distance, back):  # type: ignore[no-untyped-def]
    """Hamming distances between a (N, 4) and b (4, M), 256 bits each, of all pairs at once.

    Write of each a the least and the second distance and which b is nearest, first, second, index (N,), and of each b
    the least distance and which a, back_distance, back (M,); larger distances stood there. The first of equals counts.
    """
    pairs, fours = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
    nibbles, bytes_, ones = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)
    by1, by2, by4, by8, by48 = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(8), np.uint64(48)
    row = np.empty(b.shape[1], np.int32)
    for i in range(len(a)):
        for j in range(b.shape[1]):  # bits are counted in parallel, in ever wider fields
            x, y, z, w = a[i, 0] ^ b[0, j], a[i, 1] ^ b[1, j], a[i, 2] ^ b[2, j], a[i, 3] ^ b[3, j]
            x -= (x >> by1) & pairs
            y -= (y >> by1) & pairs
            z -= (z >> by1) & pairs
            w -= (w >> by1) & pairs
            x = (x & fours) + ((x >> by2) & fours) + (y & fours) + ((y >> by2) & fours)
            z = (z & fours) + ((z >> by2) & fours) + (w & fours) + ((w >> by2) & fours)
            x = (x & nibbles) + ((x >> by4) & nibbles) + (z & nibbles) + ((z >> by4) & nibbles)
            x = (x & bytes_) + ((x >> by8) & bytes_)
            row[j] = np.int32((x * ones) >> by48)
        for j in range(b.shape[1]):
            d = row[j]
            if d < back_distance[j]:
                back_distance[j], back[j] = d, i
            if d < first[i]:
                first[i], second[i], index[i] = d, first[i], j
            elif d < second[i]:
                second[i] = d


def match(
    a: NDArray[np.uint8], b: NDArray[np.uint8], farthest: int = 64, ratio: float = 0.85
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Mutual nearest neighbours by Hamming distance that pass the ratio test: indices into a and b."""
    none = np.empty(0, np.int64)
    if len(a) == 0 or len(b) < 2:
        return none, none
    more = 8 * BYTES + 1
    first, second, index = np.full(len(a), more, np.int32), np.full(len(a), more, np.int32), np.zeros(len(a), np.int64)
    nearest, back = np.full(len(b), more, np.int32), np.zeros(len(b), np.int64)
    _nearest(_words(a), np.ascontiguousarray(_words(b).T), first, second, index, nearest, back)
    i = np.arange(len(a))
    good = (first <= farthest) & (first < ratio * second) & (back[index] == i)
    return i[good], index[good]


def _words(descriptors: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """(N, 4) of descriptors (N, 32)."""
    return np.ascontiguousarray(descriptors).view(np.uint64)

"""PatchMatch stereo on the sphere: a plane for each pixel of a panorama, on which other panoramas agree.

Each pixel keeps the best of its neighbours' planes and of random changes to its own (Bleyer, Rhemann & Rother,
"PatchMatch stereo: stereo matching with slanted support windows", 2011); pixels of the two colours of a chessboard take
turns (Galliani, Lasinger & Schindler, "Massively parallel multiview stereopsis by surface normal diffusion", 2015).

A plane is a vector a with a . X = 1 for its points X in the camera's frame, so that the depth along a unit ray r is
1 / (a . r), and its points lie in the directions (R + t a^T) r of another camera with X' = R X + t.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange

Float = NDArray[np.float32]

_HALF, _ONE, _ZERO, _TWO = np.float32(0.5), np.float32(1), np.float32(0), np.float32(2)
_PER_TURN = np.float32(0.5 / np.pi)
#: The least cosine between a ray and the normal of its plane.
_STEEPEST = np.float32(0.05)
#: The least weight of a window that must be known in a frame.
_KNOWN = np.float32(0.3)
#: Neighbours whose planes a pixel tries, rows and columns: all of the other colour of the chessboard.
_NEIGHBOURS = np.array([[0, -1], [0, 1], [-1, 0], [1, 0], [0, -5], [0, 5], [-5, 0], [5, 0]], np.int64)


def window(spacing: int) -> Float:
    """Samples of a window, (32, 3): row and column from its middle, in pixels, and minus the log of their weight.

    They lie on a square without its corners. Loops over 32 are vectorised without a rest.
    """
    at = [(j, i) for j in range(-5, 6, 2) for i in range(-5, 6, 2) if abs(i) + abs(j) < 10]
    return np.array([(j * spacing // 2, i * spacing // 2, (i * i + j * j) / 50) for j, i in at], np.float32)


@njit(**JIT_FINITE)
def _place(R, t, a0, a1, a2, window, w, h, u, v):  # type: ignore[no-untyped-def]
    """Write where the samples of a window that lies on a plane are in a padded image, u, v (N,)."""
    h00, h01, h02 = R[0, 0] + t[0] * a0, R[0, 1] + t[0] * a1, R[0, 2] + t[0] * a2
    h10, h11, h12 = R[1, 0] + t[1] * a0, R[1, 1] + t[1] * a1, R[1, 2] + t[1] * a2
    h20, h21, h22 = R[2, 0] + t[2] * a0, R[2, 1] + t[2] * a1, R[2, 2] + t[2] * a2
    for i in range(len(u)):
        rx, ry, rz = window[0, i], window[1, i], window[2, i]
        x, y, z = h00 * rx + h01 * ry + h02 * rz, h10 * rx + h11 * ry + h12 * rz, h20 * rx + h21 * ry + h22 * rz
        c = w * (_HALF + atan2_fast(x, z) * _PER_TURN) + _HALF
        r = h * (_HALF + _TWO * atan2_fast(y, np.sqrt(x * x + z * z)) * _PER_TURN) + _HALF
        u[i], v[i] = min(max(c, _HALF), w + _HALF), min(max(r, _ZERO), h)


@njit(**JIT)
def _compare(flat, stride, u, v, window, truncation):  # type: ignore[no-untyped-def]
    """Weighted sum of truncated differences of luma at u, v (N,), and the weights of what is known."""
    total, known = _ZERO, _ZERO
    for i in range(len(u)):
        column, row = np.uint32(u[i]), np.uint32(v[i])
        a, b = u[i] - np.float32(column), v[i] - np.float32(row)
        k = np.uint32(row * stride + column)
        k1 = np.uint32(k + np.uint32(1))
        m, m1 = np.uint32(k + stride), np.uint32(k1 + stride)
        top = flat[k] + a * (flat[k1] - flat[k])
        bottom = flat[m] + a * (flat[m1] - flat[m])
        s = abs(top + b * (bottom - top) - window[3, i])
        there = s == s
        total += window[4, i] * min(s, truncation) if there else _ZERO
        known += window[4, i] if there else _ZERO
    return total, known


@njit(**JIT)
def _cost(frames, R, t, a0, a1, a2, window, truncation, best, costs):  # type: ignore[no-untyped-def]
    """Mean cost of the ``best`` views of those that agree best, the others may be hidden. costs (F,): work space."""
    n, m = frames.shape[0], window.shape[1]
    h, w, stride = np.float32(frames.shape[1] - 2), np.float32(frames.shape[2] - 2), np.uint32(frames.shape[2])
    u, v = costs[n : n + m], costs[n + m :]
    for f in range(n):
        _place(R[f], t[f], a0, a1, a2, window, w, h, u, v)
        total, known = _compare(frames[f].reshape(-1), stride, u, v, window, truncation)
        c = total / known if known > _KNOWN else truncation
        k = f
        while k > 0 and costs[k - 1] > c:
            costs[k] = costs[k - 1]
            k -= 1
        costs[k] = c
    total = _ZERO
    for f in range(best):
        total += costs[f]
    return total / np.float32(best)


@njit(**JIT)
def _gather(luma, rays, y, x, samples, by_luma, window):  # type: ignore[no-untyped-def]
    """Write rays, luma and weights (5, N) of the samples around a pixel; the weights sum to one."""
    h, w = luma.shape
    # The window covers about the same angles at all latitudes.
    wide = _ONE / max(np.float32(np.cos((0.5 - (y + 0.5) / h) * np.pi)), np.float32(0.15))
    middle, total = luma[y, x], _ZERO
    for n in range(window.shape[1]):
        q = min(max(y + int(samples[n, 0]), 0), h - 1)
        p = x + int(np.rint(wide * samples[n, 1]))
        p = p + w if p < 0 else (p - w if p >= w else p)
        value = luma[q, p]
        there = value == value
        weight = np.exp(-abs(value - middle) * by_luma - samples[n, 2]) if there else _ZERO
        for c in range(3):
            window[c, n] = rays[q, p, c]
        window[3, n], window[4, n] = value if there else _ZERO, weight
        total += weight
    for n in range(window.shape[1]):
        window[4, n] /= total


@njit(**JIT)
def _pixels_alike(y, h):  # type: ignore[no-untyped-def]
    """How many pixels of a row of a panorama of h rows cover about what one does at the horizon: 1, 2 or 4."""
    narrow = np.cos((0.5 - (y + 0.5) / h) * np.pi)
    return 1 if narrow > 0.5 else (2 if narrow > 0.25 else 4)


@njit(**JIT)
def _random(state):  # type: ignore[no-untyped-def]
    """The next state of a stream of random numbers, and a number in -1..1 (Marsaglia, "Xorshift RNGs", 2003)."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    state ^= state << np.uint64(17)
    return state, np.float32(state >> np.uint64(40)) * np.float32(2.0 / (1 << 24)) - _ONE


@njit(**JIT)
def _changed(a0, a1, a2, rx, ry, rz, by_depth, by_normal, state):  # type: ignore[no-untyped-def]
    """A plane whose depth along r differs by a factor of up to exp(by_depth), and its normal by ``by_normal``."""
    state, e = _random(state)
    state, e0 = _random(state)
    state, e1 = _random(state)
    state, e2 = _random(state)
    unit = _ONE / np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    b0, b1, b2 = a0 * unit + by_normal * e0, a1 * unit + by_normal * e1, a2 * unit + by_normal * e2
    inverse = (a0 * rx + a1 * ry + a2 * rz) * np.exp(by_depth * e)
    scale = inverse / (b0 * rx + b1 * ry + b2 * rz)
    return b0 * scale, b1 * scale, b2 * scale, state


@njit(**PARALLEL)
def try_planes(candidates, luma, rays, frames, R, t, best, samples, options, planes, cost):  # type: ignore[no-untyped-def]
    """Write the candidates (h, w, 3; NaN: none) that cost less than ``cost`` (h, w) into it and ``planes`` (h, w, 3).

    luma (H, W), rays (H, W, 3): of the view; H is h or a multiple, and a plane's window is about the first of its
    pixels. frames (F, H + 2, W + 2): others, ``padded``. R (F, 3, 3), t (F, 3): frame from view. best: so many of
    the frames count. samples (N, 3): see ``window``. options (4,): truncation, 1 / sigma of luma in the window's
    weights, cost that a better plane must save, and difference (of 1) below which planes are the same. Everything is
    float32.
    Near the poles, runs of two or four pixels have the plane of their first.
    """
    h, w = cost.shape
    finer = luma.shape[0] // h
    for y in prange(h):
        window = np.empty((5, len(samples)), np.float32)
        costs = np.empty(frames.shape[0] + 2 * len(samples), np.float32)
        alike = _pixels_alike(y, h)
        for x in range(0, w, alike):
            a0, a1, a2, j, i = candidates[y, x, 0], candidates[y, x, 1], candidates[y, x, 2], finer * y, finer * x
            ahead = a0 * rays[j, i, 0] + a1 * rays[j, i, 1] + a2 * rays[j, i, 2] > _ZERO
            if not (ahead and luma[j, i] == luma[j, i]):
                continue
            _gather(luma, rays, j, i, samples, options[1], window)
            c = _cost(frames, R, t, a0, a1, a2, window, options[0], best, costs)
            if c < cost[y, x] - options[2]:
                for n in range(x, min(x + alike, w)):
                    cost[y, n] = c
                    planes[y, n, 0], planes[y, n, 1], planes[y, n, 2] = a0, a1, a2


@njit(**PARALLEL)
def propagate(  # type: ignore[no-untyped-def]
    luma,
    rays,
    frames,
    R,
    t,
    best,
    samples,
    options,
    limits,
    neighbours,
    tries,
    changes,
    colour,
    seed,
    before,
    planes,
    cost,
):
    """Pixels of one colour of the chessboard try the planes of their neighbours, then changes of their own.

    limits (2,): of the depth. neighbours: 4 at one pixel's distance, or 8 with four farther away. tries: of changes,
    each half as large as the last, from ``changes`` (2,): of log depth and of the unit normal. seed: of the random
    numbers, int. before: a copy of ``planes``, so that the order of rows does not count. The other arguments are as in
    ``try_planes``.
    """
    h, w = cost.shape
    finer = luma.shape[0] // h
    for y in prange(h):
        window = np.empty((5, len(samples)), np.float32)
        costs = np.empty(frames.shape[0] + 2 * len(samples), np.float32)
        alike = _pixels_alike(y, h)
        if alike > 1 and (y + colour) % 2:
            continue
        for x in range((y + colour) % 2, w, max(2, alike)):
            a0, a1, a2, least = planes[y, x, 0], planes[y, x, 1], planes[y, x, 2], cost[y, x]
            j, i = finer * y, finer * x
            if not (luma[j, i] == luma[j, i] and a0 == a0):
                continue
            rx, ry, rz = rays[j, i, 0], rays[j, i, 1], rays[j, i, 2]
            _gather(luma, rays, j, i, samples, options[1], window)
            state = np.uint64(y * w + x + 1) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(seed + 1)
            for _ in range(4):
                state, _e = _random(state)
            for k in range(neighbours + tries):
                if k < neighbours:
                    q, p = y + _NEIGHBOURS[k, 0], (x + _NEIGHBOURS[k, 1] + w) % w
                    if q < 0 or q >= h:
                        continue
                    b0, b1, b2 = before[q, p, 0], before[q, p, 1], before[q, p, 2]
                    there = a0 * rx + a1 * ry + a2 * rz
                    if max(abs(b0 - a0), abs(b1 - a1), abs(b2 - a2)) < options[3] * there:
                        continue
                else:
                    size = _HALF ** np.float32(k - neighbours)
                    b0, b1, b2, state = _changed(a0, a1, a2, rx, ry, rz, changes[0] * size, changes[1] * size, state)
                inverse = b0 * rx + b1 * ry + b2 * rz
                upright = inverse > _STEEPEST * np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
                if not (upright and inverse * limits[0] < _ONE and inverse * limits[1] > _ONE):
                    continue
                c = _cost(frames, R, t, b0, b1, b2, window, options[0], best, costs)
                if c < least - options[2]:
                    a0, a1, a2, least = b0, b1, b2, c
            for n in range(x, min(x + alike, w)):
                planes[y, n, 0], planes[y, n, 1], planes[y, n, 2], cost[y, n] = a0, a1, a2, least

"""Plane sweep on the sphere, and semi-global matching: depth of one image from several with known poses.

The sweep is that of Collins, "A space-sweep approach to true multi-image matching" (1996), with spherical shells about
the reference camera for planes. Semi-global matching along four paths follows Hirschmueller, "Stereo processing by
semiglobal matching and mutual information" (2008). On panoramas columns wrap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.columns import CAM
from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange
from panobench.photometric.lens_centres import moved_origin, shells_from_lenses
from panobench.photometric.pyramid import F32
from panobench.photometric.warp import sample, to_pixel


def padded(frames: F32, wrap: bool) -> F32:
    """Images (F, H, W) with a border of one pixel: on panoramas rows repeat and columns wrap, elsewhere it is NaN."""
    out = np.full((frames.shape[0], frames.shape[1] + 2, frames.shape[2] + 2), np.nan, np.float32)
    out[:, 1:-1, 1:-1] = frames
    if wrap:
        out[:, :, 0], out[:, :, -1] = out[:, :, -2], out[:, :, 1]
        out[:, 0], out[:, -1] = out[:, 1], out[:, -2]
    return out


@njit(**JIT_FINITE)
def _shells_panorama(depths, rx, ry, rz, tx, ty, tz, w, h, u, v):  # type: ignore[no-untyped-def]
    """Write coordinates u, v (D,) in a padded panorama, to be floored, of the points depths[k] r + t."""
    per_turn = np.float32(0.5 / np.pi)
    half = np.float32(0.5)
    for k in range(len(depths)):
        x, y, z = depths[k] * rx + tx, depths[k] * ry + ty, depths[k] * rz + tz
        rho = np.sqrt(x * x + z * z)
        a = w * (half + atan2_fast(x, z) * per_turn) + half
        b = h * (half + np.float32(2) * atan2_fast(y, rho) * per_turn) + half
        u[k], v[k] = min(max(a, half), w + half), min(max(b, np.float32(0)), h)


@njit(**JIT_FINITE)
def _shells_pinhole(depths, rx, ry, rz, tx, ty, tz, cam, u, v):  # type: ignore[no-untyped-def]
    """As ``_shells_panorama``; points outside the image are put on its border of NaN."""
    half = np.float32(0.5)
    for k in range(len(depths)):
        x, y, z = depths[k] * rx + tx, depths[k] * ry + ty, depths[k] * rz + tz
        front = z >= np.float32(1e-3)
        inv = np.float32(1) / (z if front else np.float32(1))
        a = cam[CAM.fx] * x * inv + cam[CAM.cx] + half
        b = cam[CAM.fy] * y * inv + cam[CAM.cy] + half
        u[k] = min(max(a, np.float32(0)), cam[CAM.width]) if front else np.float32(0)
        v[k] = min(max(b, np.float32(0)), cam[CAM.height]) if front else np.float32(0)


@njit(**JIT)
def _add_differences(image, u, v, value, truncation, cost, hits):  # type: ignore[no-untyped-def]
    """Where the padded image is known at u, v (D,), cost += min(|I(u, v) - value|, truncation) and hits += 1."""
    for k in range(len(cost)):
        x, y = np.uint32(u[k]), np.uint32(v[k])
        a, b = u[k] - np.float32(x), v[k] - np.float32(y)
        x1, y1 = x + np.uint32(1), y + np.uint32(1)
        top = image[y, x] + a * (image[y, x1] - image[y, x])
        bottom = image[y1, x] + a * (image[y1, x1] - image[y1, x])
        s = abs(top + b * (bottom - top) - value)
        known = s == s
        cost[k] += min(s, truncation) if known else np.float32(0)
        hits[k] += np.float32(1) if known else np.float32(0)


@njit(**PARALLEL)
def sweep_cost(reference, rays, frames, R, t, depths, code, cam, truncation, first, last, out):  # type: ignore[no-untyped-def]
    """Write the mean truncated |I_f - I_r| over the frames first .. last - 1 for each pixel and shell, out (H, W, D).

    reference (H, W): luma. rays (H, W, 3) float32. frames (F, H + 2, W + 2): ``padded``. R (F, 3, 3), t (F, 3): frame
    from reference camera. depths (D,): radii of the shells. truncation: of 1. Samples outside a frame's view do not
    count; a pixel that no frame sees costs half the truncation at all depths.
    """
    h, w = reference.shape
    n_depths = len(depths)
    for y in prange(h):
        hits = np.empty(n_depths, np.float32)
        u, v = np.empty(n_depths, np.float32), np.empty(n_depths, np.float32)
        for x in range(w):
            cost = out[y, x]
            for k in range(n_depths):
                cost[k] = np.float32(0)
                hits[k] = np.float32(0)
            value = reference[y, x]
            if value == value:
                for f in range(first, last):
                    rx = R[f, 0, 0] * rays[y, x, 0] + R[f, 0, 1] * rays[y, x, 1] + R[f, 0, 2] * rays[y, x, 2]
                    ry = R[f, 1, 0] * rays[y, x, 0] + R[f, 1, 1] * rays[y, x, 1] + R[f, 1, 2] * rays[y, x, 2]
                    rz = R[f, 2, 0] * rays[y, x, 0] + R[f, 2, 1] * rays[y, x, 1] + R[f, 2, 2] * rays[y, x, 2]
                    if cam.ndim == 2:
                        tx, ty, tz = moved_origin(R[f], t[f], rays[y, x, 0], rays[y, x, 1], rays[y, x, 2], cam)
                        shells_from_lenses(depths, rx, ry, rz, tx, ty, tz, cam, u, v)
                    elif code == 0:
                        _shells_panorama(
                            depths, rx, ry, rz, t[f, 0], t[f, 1], t[f, 2], cam[CAM.width], cam[CAM.height], u, v
                        )
                    else:
                        _shells_pinhole(depths, rx, ry, rz, t[f, 0], t[f, 1], t[f, 2], cam, u, v)
                    _add_differences(frames[f], u, v, value, truncation, cost, hits)
            for k in range(n_depths):
                cost[k] = cost[k] / hits[k] if hits[k] > 0 else np.float32(0.5) * truncation


@njit(**PARALLEL)
def reprojection_error(reference, rays, frames, R, t, depth, code, cam, truncation, out):  # type: ignore[no-untyped-def]
    """Write the mean truncated |I_f - I_r| over all frames at a given depth (H, W), out (H, W); NaN without depth.

    frames (F, H, W): without padding. The other arguments are as in ``sweep_cost``.
    """
    h, w = reference.shape
    for y in prange(h):
        for x in range(w):
            d, value = depth[y, x], reference[y, x]
            cost, hits = np.float32(0), np.float32(0)
            if d == d and value == value:
                for f in range(frames.shape[0]):
                    rx = R[f, 0, 0] * rays[y, x, 0] + R[f, 0, 1] * rays[y, x, 1] + R[f, 0, 2] * rays[y, x, 2]
                    ry = R[f, 1, 0] * rays[y, x, 0] + R[f, 1, 1] * rays[y, x, 1] + R[f, 1, 2] * rays[y, x, 2]
                    rz = R[f, 2, 0] * rays[y, x, 0] + R[f, 2, 1] * rays[y, x, 1] + R[f, 2, 2] * rays[y, x, 2]
                    tx, ty, tz = moved_origin(R[f], t[f], rays[y, x, 0], rays[y, x, 1], rays[y, x, 2], cam)
                    u, v, ok = to_pixel(d * rx + tx, d * ry + ty, d * rz + tz, code, cam)
                    if ok:
                        s = abs(sample(frames[f], u, v, code) - value)
                        if s == s:
                            cost += min(s, truncation)
                            hits += np.float32(1)
            out[y, x] = cost / hits if hits > 0 else np.float32(np.nan)


@njit(**PARALLEL)
def temporal_selection(cost, early, late, ratio, margin):  # type: ignore[no-untyped-def]
    """Where the frames contradict each other, trust one half of them: along a path, occlusion either begins or ends.

    cost, early, late (H, W, D): of all frames, and of the earlier and the later half. A pixel takes the costs of a half
    where the best shell of that half beats ``ratio`` times the best of all by ``margin``; ``cost`` is changed in place.
    The name and the idea are those of Kang, Szeliski & Chai, "Handling occlusions in dense multi-view stereo" (2001).
    """
    for y in prange(cost.shape[0]):
        for x in range(cost.shape[1]):
            a, e, l = cost[y, x].min(), early[y, x].min(), late[y, x].min()
            if min(e, l) < ratio * a - margin:
                cost[y, x] = early[y, x] if e <= l else late[y, x]


@njit(**JIT)
def _path_step(cost, before, p1, p2, line):  # type: ignore[no-untyped-def]
    """One step along a path: write the path costs ``line`` (D,) of a pixel, from those of the pixel ``before`` it."""
    n = len(cost)
    low = before[0]
    for k in range(1, n):
        low = min(low, before[k])
    for k in range(n):
        best = min(before[k], low + p2)
        if k > 0:
            best = min(best, before[k - 1] + p1)
        if k < n - 1:
            best = min(best, before[k + 1] + p1)
        line[k] = cost[k] + best - low


@njit(**PARALLEL)
def semi_global(cost, luma, p1, p2, edge, wrap):  # type: ignore[no-untyped-def]
    """The sum of the costs of the four paths, (H, W, D), of a cost volume (H, W, D).

    p1: penalty of a change by one shell. p2: of a larger one, which is less across edges of the image luma (H, W):
    p2 / (1 + edge |difference|), but at least p1. wrap: columns wrap.
    """
    h, w, n = cost.shape
    total = np.zeros((h, w, n), np.float32)
    for y in prange(h):
        a, b = np.zeros(n, np.float32), np.empty(n, np.float32)
        for direction in range(2):
            a[:] = 0
            # On a panorama the path starts half the width early, so that the seam is no boundary.
            lead = w // 2 if wrap else 0
            for i in range(-lead, w):
                x = i % w if direction == 0 else (w - 1 - i) % w
                q = (x - 1) % w if direction == 0 else (x + 1) % w
                p = p2 / (np.float32(1) + edge * abs(luma[y, x] - luma[y, q]))
                p = p if p > p1 else p1
                _path_step(cost[y, x], a, p1, p, b)
                if i >= 0:
                    for k in range(n):
                        total[y, x, k] += b[k]
                a, b = b, a
    for x in prange(w):
        a, b = np.zeros(n, np.float32), np.empty(n, np.float32)
        for direction in range(2):
            a[:] = 0
            for i in range(h):
                y = i if direction == 0 else h - 1 - i
                q = max(y - 1, 0) if direction == 0 else min(y + 1, h - 1)
                p = p2 / (np.float32(1) + edge * abs(luma[y, x] - luma[q, x]))
                p = p if p > p1 else p1
                _path_step(cost[y, x], a, p1, p, b)
                for k in range(n):
                    total[y, x, k] += b[k]
                a, b = b, a
    return total


@njit(**PARALLEL)
def winner_takes_all(total, log_depth0, log_step, depth, confidence):  # type: ignore[no-untyped-def]
    """Write the depth (H, W) of least cost, refined by a parabola through its neighbours, and a confidence (H, W).

    total (H, W, D): costs; shells are equally spaced in log depth. confidence, 0..1: one minus the ratio of the least
    cost to the least that is more than two shells away.
    """
    h, w, n = total.shape
    for y in prange(h):
        for x in range(w):
            c = total[y, x]
            k = 0
            for i in range(1, n):
                if c[i] < c[k]:
                    k = i
            shift = 0.0
            if 0 < k < n - 1:
                bend = c[k - 1] - 2 * c[k] + c[k + 1]
                if bend > 1e-12:
                    shift = 0.5 * (c[k - 1] - c[k + 1]) / bend
            depth[y, x] = np.exp(log_depth0 + (k + shift) * log_step)
            second = np.float32(1e30)
            for i in range(n):
                if abs(i - k) > 2:
                    second = min(second, c[i])
            confidence[y, x] = 1 - c[k] / max(second, np.float32(1e-12))


@njit(**PARALLEL)
def _smooth_rows(cost, kernel, wrap, out):  # type: ignore[no-untyped-def]
    """Convolve the rows of a cost volume with a kernel (K,); those of a panorama wrap, others repeat their ends."""
    h, w, n = cost.shape
    reach = len(kernel) // 2
    for y in prange(h):
        for x in range(w):
            total = out[y, x]
            for k in range(n):
                total[k] = np.float32(0)
            for i in range(-reach, reach + 1):
                q = x + i
                if wrap:
                    q = (q + w) % w
                else:
                    q = min(max(q, 0), w - 1)
                weight, c = kernel[i + reach], cost[y, q]
                for k in range(n):
                    total[k] += weight * c[k]


@njit(**PARALLEL)
def _smooth_columns(cost, kernel, out):  # type: ignore[no-untyped-def]
    """Convolve the columns of a cost volume with a kernel (K,); they repeat their ends."""
    h, w, n = cost.shape
    reach = len(kernel) // 2
    for y in prange(h):
        for x in range(w):
            total = out[y, x]
            for k in range(n):
                total[k] = np.float32(0)
            for i in range(-reach, reach + 1):
                weight, c = kernel[i + reach], cost[min(max(y + i, 0), h - 1), x]
                for k in range(n):
                    total[k] += weight * c[k]


def smooth_cost(cost: NDArray[np.float32], sigma: float, wrap: bool) -> F32:
    """Aggregate a cost volume (H, W, D) by a Gaussian of ``sigma`` pixels, across the seam of a panorama (``wrap``)."""
    reach = min(int(np.ceil(4 * sigma)), cost.shape[1] - 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel = (kernel / kernel.sum()).astype(np.float32)
    rows, out = np.empty_like(cost), np.empty_like(cost)
    _smooth_rows(cost, kernel, wrap, rows)
    _smooth_columns(rows, kernel, out)
    return out

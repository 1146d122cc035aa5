"""Binning: which Gaussians each tile has to composite, in depth order, and in which of its rows."""

from __future__ import annotations

import numpy as np

from panobench.kernels.columns import CAM
from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.jit import INLINE, JIT, PARALLEL, njit, prange
from panobench.splat.row_bounds import row_bounds
from panobench.splat.view import BOUND_CONES, TILE_H, TILE_W


@njit(**JIT)
def radix_order(key):  # type: ignore[no-untyped-def]
    """Indices of the keys (N,) float32 that are not negative, ascending; of equal keys the lower index comes first."""
    n = 0
    for k in range(len(key)):
        if key[k] >= 0:
            n += 1
    a, b = np.empty(n, np.int32), np.empty(n, np.int32)
    n = 0
    for k in range(len(key)):
        if key[k] >= 0:
            a[n] = k
            n += 1
    bits = key.view(np.uint32)  # the bit patterns of non-negative floats sort like the floats
    for step in range(3):
        shift, mask = np.uint32(11 * step), np.uint32(0x7FF)
        counts = np.zeros(2049, np.int64)
        for i in range(n):
            counts[((bits[a[i]] >> shift) & mask) + 1] += 1
        for i in range(2048):
            counts[i + 1] += counts[i]
        for i in range(n):
            d = (bits[a[i]] >> shift) & mask
            b[counts[d]] = a[i]
            counts[d] += 1
        a, b = b, a
    return a


@njit(**PARALLEL)
def gather(order, footprints, rows, cols):  # type: ignore[no-untyped-def]
    """Rows ``order`` (M,) of the three arrays; NumPy's indexing takes several times as long."""
    n = len(order)
    p, r, c = np.empty((n, footprints.shape[1]), np.float32), np.empty((n, 2), np.int32), np.empty((n, 2), np.int32)
    for j in prange(n):
        k = order[j]
        for i in range(footprints.shape[1]):
            p[j, i] = footprints[k, i]
        r[j, 0], r[j, 1], c[j, 0], c[j, 1] = rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1]
    return p, r, c


@njit(**JIT)
def _cone_meets(p, cone):  # type: ignore[no-untyped-def]
    """Whether the cone of footprint p meets that of a tile (4,): direction and cosine of its angular radius.

    They meet where the cosine of the angle between them is at least that of the sum of their radii.
    """
    c = cone[3]
    if c > 1.5:
        return False
    s = np.sqrt(max(1.0 - c * c, 0.0))
    cos_p, sin_p = p[F.cos_radius], p[F.sin_radius]
    if sin_p * c + cos_p * s < 0:  # the two radii together exceed pi
        return True
    return p[F.m[0]] * cone[0] + p[F.m[1]] * cone[1] + p[F.m[2]] * cone[2] >= cos_p * c - sin_p * s - 1e-6


@njit(**INLINE)
def _tile_columns(c0, c1, W):  # type: ignore[no-untyped-def]
    """Columns of tiles for pixel columns c0 .. c1, which may pass a panorama's edge: two runs, first and last each."""
    if c1 - c0 >= W - 1:
        return 0, (W - 1) // TILE_W, 1, 0
    x0, x1 = max(c0, 0) // TILE_W, min(c1, W - 1) // TILE_W
    if c0 < 0:
        return x0, x1, max((c0 + W) // TILE_W, x1 + 1), (W - 1) // TILE_W
    if c1 >= W:
        return x0, x1, 0, min((c1 - W) // TILE_W, x0 - 1)
    return x0, x1, 1, 0


@njit(**JIT)
def _columns_met(k0, k1, cols, W, which, columns):  # type: ignore[no-untyped-def]
    """Pair footprints k0 .. k1 - 1 with every column of tiles that they may reach; returns the number of pairs.

    The pairs are written to ``which`` and ``columns`` (S,), unless these are empty.
    """
    n = 0
    for k in range(k0, k1):
        a, b, c, d = _tile_columns(cols[k, 0], cols[k, 1], W)
        if len(which) == 0:
            n += b - a + 1 + d - c + 1
            continue
        for x in range(a, b + 1):
            which[n], columns[n] = k, x
            n += 1
        for x in range(c, d + 1):
            which[n], columns[n] = k, x
            n += 1
    return n


@njit(**JIT)
def _tiles_met(k0, k1, footprints, cones, W, H, which, columns, first, last):  # type: ignore[no-untyped-def]
    """Pair footprints k0 .. k1 - 1 with every tile whose cone they meet, for cameras without ``column_axes``.

    As ``_columns_met``; first, last (S,) receive the rows of the tile.
    """
    tiles_x, n = (W + TILE_W - 1) // TILE_W, 0
    for k in range(k0, k1):
        for t in range(len(cones)):
            if _cone_meets(footprints[k], cones[t]):
                if len(which) > 0:
                    y = t // tiles_x * TILE_H
                    which[n], columns[n], first[n], last[n] = k, t % tiles_x, y, min(y + TILE_H, H) - 1
                n += 1
    return n


@njit(**PARALLEL)
def bin_tiles(  # type: ignore[no-untyped-def]
    footprints, rows, cols, bound, cones, column_axes, column_half, intr, drawn, threads
):
    """Lists of the footprints in each tile, for M footprints sorted by depth.

    footprints (M, FOOTPRINT_COLUMNS), rows, cols (M, 2): as ``project`` writes them, in order of depth. bound, cones,
    column_axes, column_half, intr: the view's. drawn (tiles,) bool: tiles that need a list.

    Returns starts (tiles + 1,) int64 and entries (E,) int32: tile t has the footprints numbered
    entries[starts[t] : starts[t + 1]], nearest first. Also spans (E, 2) uint8: the first row within the tile that an
    entry may colour, and the number of rows.

    Each thread takes a run of footprints, and its entries stand after those of nearer runs: the lists do not depend on
    the number of threads.
    """
    W, H, n, tiles = int(intr[CAM.width]), int(intr[CAM.height]), len(rows), len(drawn)
    tiles_x, share = (W + TILE_W - 1) // TILE_W, (n + threads - 1) // threads
    nothing = np.empty(0, np.int32)
    begins = np.zeros(threads + 1, np.int64)
    for th in prange(threads):
        k0, k1 = min(th * share, n), min((th + 1) * share, n)
        if bound == BOUND_CONES:
            begins[th + 1] = _tiles_met(k0, k1, footprints, cones, W, H, nothing, nothing, nothing, nothing)
        else:
            begins[th + 1] = _columns_met(k0, k1, cols, W, nothing, nothing)
    for th in range(threads):
        begins[th + 1] += begins[th]
    pairs = np.empty((4, begins[threads]), np.int32)  # footprint, column of tiles, first and last pixel row
    cursor = np.zeros((threads, tiles), np.int64)
    for th in prange(threads):
        k0, k1 = min(th * share, n), min((th + 1) * share, n)
        mine = pairs[:, begins[th] : begins[th + 1]]
        if mine.shape[1] == 0:
            continue
        if bound == BOUND_CONES:
            _tiles_met(k0, k1, footprints, cones, W, H, mine[0], mine[1], mine[2], mine[3])
        else:
            _columns_met(k0, k1, cols, W, mine[0], mine[1])
            if len(column_axes) > 0:
                row_bounds(
                    mine[0], mine[1], footprints, rows, bound, column_axes, column_half, intr, mine[2], mine[3]
                )  # fmt: skip
            else:
                for s in range(mine.shape[1]):
                    mine[2, s], mine[3, s] = rows[mine[0, s], 0], rows[mine[0, s], 1]
        for s in range(mine.shape[1]):
            if mine[3, s] >= mine[2, s]:
                for y in range(mine[2, s] // TILE_H, mine[3, s] // TILE_H + 1):
                    cursor[th, y * tiles_x + mine[1, s]] += 1
    starts = np.zeros(tiles + 1, np.int64)
    for t in range(tiles):
        total = starts[t]
        for th in range(threads):
            count = cursor[th, t] if drawn[t] else 0
            cursor[th, t] = total
            total += count
        starts[t + 1] = total
    entries, spans = np.empty(max(starts[tiles], 1), np.int32), np.empty((max(starts[tiles], 1), 2), np.uint8)
    for th in prange(threads):
        for s in range(begins[th], begins[th + 1]):
            r0, r1 = pairs[2, s], pairs[3, s]
            if r1 < r0:
                continue
            for y in range(r0 // TILE_H, r1 // TILE_H + 1):
                t = y * tiles_x + pairs[1, s]
                if drawn[t]:
                    e = cursor[th, t]
                    low = max(r0 - y * TILE_H, 0)
                    entries[e], spans[e, 0], spans[e, 1] = pairs[0, s], low, min(r1 - y * TILE_H + 1, TILE_H) - low
                    cursor[th, t] += 1
    return starts, entries, spans

"""Which Gaussians a tile has to composite, in depth order."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from panobench.splat.kernel_options import INLINE, JIT, PARALLEL, TILE_H, TILE_W
from panobench.splat.view import BOUND_CONES


@njit(**JIT)
def radix_order(key):  # type: ignore[no-untyped-def]
    """Indices of the keys (N,) float32 >= 0 in ascending order; ties keep their index order."""
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
def gather(order, packed, rows, cols):  # type: ignore[no-untyped-def]
    """Rows of the three arrays in ``order``; fancy indexing takes several times as long."""
    n = len(order)
    p, r, c = np.empty((n, packed.shape[1]), np.float32), np.empty((n, 2), np.int32), np.empty((n, 2), np.int32)
    for j in prange(n):
        k = order[j]
        for i in range(packed.shape[1]):
            p[j, i] = packed[k, i]
        r[j, 0], r[j, 1], c[j, 0], c[j, 1] = rows[k, 0], rows[k, 1], cols[k, 0], cols[k, 1]
    return p, r, c


@njit(**JIT)
def _cone_meets(p, cone):  # type: ignore[no-untyped-def]
    """Does the instance's cone meet the tile's? cos(angle) >= cos(reach + radius), unless the sum exceeds pi."""
    c = cone[3]
    if c > 1.5:
        return False
    s = np.sqrt(max(1.0 - c * c, 0.0))
    if p[17] * c + p[16] * s < 0:  # sin(reach + radius) < 0: together they span more than a half turn
        return True
    return p[6] * cone[0] + p[7] * cone[1] + p[8] * cone[2] >= p[16] * c - p[17] * s - 1e-6


@njit(**INLINE)
def _visit(k, packed, rows, cols, W, tiles_x, tiles, bound, cones, drawn, cursor, entries):  # type: ignore[no-untyped-def]
    """Advance ``cursor`` of every drawn tile instance k may touch, writing k there unless ``entries`` is empty."""
    fill = len(entries) > 0
    if bound == BOUND_CONES:
        for t in range(tiles):
            if drawn[t] and _cone_meets(packed[k], cones[t]):
                if fill:
                    entries[cursor[t]] = k
                cursor[t] += 1
        return
    y0, y1 = rows[k, 0] // TILE_H, rows[k, 1] // TILE_H
    c0, c1 = cols[k, 0], cols[k, 1]
    if c1 - c0 >= W - 1:
        c0, c1 = 0, W - 1
    # A panorama's footprint may pass either edge: at most two runs of columns.
    for part in range(2):
        if part == 0:
            x0, x1 = max(c0, 0), min(c1, W - 1)
        elif c0 < 0:
            x0, x1 = max(c0 + W, c1 // TILE_W * TILE_W + TILE_W), W - 1
        elif c1 >= W:
            x0, x1 = 0, min(c1 - W, c0 // TILE_W * TILE_W - 1)
        else:
            break
        if x1 < x0:
            continue
        for ty in range(y0, y1 + 1):
            for t in range(ty * tiles_x + x0 // TILE_W, ty * tiles_x + x1 // TILE_W + 1):
                if drawn[t]:
                    if fill:
                        entries[cursor[t]] = k
                    cursor[t] += 1


@njit(**PARALLEL)
def bin_tiles(packed, rows, cols, W, tiles_x, tiles_y, bound, cones, drawn, threads):  # type: ignore[no-untyped-def]
    """Tile lists in depth order for instances already sorted by depth: starts (tiles + 1,), entries (E,).

    drawn (tiles,): tiles that need a list; the others' stay empty.

    Each thread takes a run of instances; its entries stand behind those of nearer runs, so the lists do not depend
    on the number of threads.
    """
    tiles, n = tiles_x * tiles_y, len(rows)
    block = (n + threads - 1) // threads
    cursor = np.zeros((threads, tiles), np.int64)
    nothing = np.empty(0, np.int32)
    for th in prange(threads):
        for k in range(th * block, min((th + 1) * block, n)):
            _visit(k, packed, rows, cols, W, tiles_x, tiles, bound, cones, drawn, cursor[th], nothing)
    starts = np.zeros(tiles + 1, np.int64)
    for t in range(tiles):
        total = starts[t]
        for th in range(threads):
            count = cursor[th, t]
            cursor[th, t] = total
            total += count
        starts[t + 1] = total
    entries = np.empty(max(starts[tiles], 1), np.int32)
    for th in prange(threads):
        for k in range(th * block, min((th + 1) * block, n)):
            _visit(k, packed, rows, cols, W, tiles_x, tiles, bound, cones, drawn, cursor[th], entries)
    return starts, entries

"""Single rays through a bounding volume hierarchy, for baking light and for mirrors; distances to primitives.

The hierarchy is binary: ``boxes`` (K, 6) has lower and upper corners, ``links`` (K, 2) either (first child, 0) or
(first primitive, count). Primitives are numbered in tree order; ``order`` gives their numbers in the mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import njit
from panobench.rooms.mesh import DISC, LEAF, TRIANGLE

LEAF_SIZE = 4  # primitives below which a node is not split


@njit(nogil=True, cache=True, error_model="numpy")
def _grow(box: Any, k: int, lo: Any, hi: Any, i: int) -> None:
    for m in range(3):
        box[k, m], box[k, 3 + m] = min(box[k, m], lo[i, m]), max(box[k, 3 + m], hi[i, m])


@njit(nogil=True, cache=True, error_model="numpy")
def _merge(box: Any, k: int, other: Any, j: int) -> float:
    """Grow box k by box j of ``other``; returns half of its surface area."""
    for m in range(3):
        box[k, m], box[k, 3 + m] = min(box[k, m], other[j, m]), max(box[k, 3 + m], other[j, 3 + m])
    x, y, z = box[k, 3] - box[k, 0], box[k, 4] - box[k, 1], box[k, 5] - box[k, 2]
    return x * y + y * z + z * x if x >= 0 else 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _empty(box: Any) -> None:
    for k in range(box.shape[0]):
        for m in range(3):
            box[k, m], box[k, 3 + m] = 1e30, -1e30


@njit(nogil=True, cache=True, error_model="numpy")
def _best_cut(
    order: Any, a: int, b: int, lo: Any, hi: Any, mid: Any, cuts: Any, bins: Any, run: Any
) -> tuple[int, float]:
    """Axis and coordinate of the cheapest split of order[a:b] by the surface area heuristic; axis -1: none."""
    n = bins.shape[0]
    best, axis, where = 1e30, -1, 0.0
    for m in range(3):
        low, high = 1e30, -1e30
        for j in range(a, b):
            low, high = min(low, mid[order[j], m]), max(high, mid[order[j], m])
        if high - low < 1e-9:
            continue
        _empty(bins)
        for k in range(n):
            cuts[k, 0] = 0.0
        for j in range(a, b):
            k = min(n - 1, int((mid[order[j], m] - low) / (high - low) * n))
            cuts[k, 0] += 1.0
            _grow(bins, k, lo, hi, order[j])
        _empty(run)
        total = 0.0
        for k in range(n - 1, 0, -1):
            total += cuts[k, 0]
            cuts[k, 1] = total * _merge(run, 0, bins, k)
        total = 0.0
        for k in range(n - 1):
            total += cuts[k, 0]
            cost = total * _merge(run, 1, bins, k) + cuts[k + 1, 1]
            if total > 0 and total < b - a and cost < best:
                best, axis, where = cost, m, low + (k + 1) * (high - low) / n
    return axis, where


@njit(nogil=True, cache=True, error_model="numpy")
def _build(
    lo: Any, hi: Any, mid: Any, order: Any, boxes: Any, links: Any, cuts: Any, bins: Any, run: Any, spans: Any
) -> int:
    top, used = 0, 1
    spans[0, 0], spans[0, 1], spans[0, 2] = 0, 0, lo.shape[0]
    _empty(boxes)
    while top >= 0:
        node, a, b = spans[top, 0], spans[top, 1], spans[top, 2]
        top -= 1
        for j in range(a, b):
            _grow(boxes, node, lo, hi, order[j])
        axis, where = -1, 0.0
        if b - a > LEAF_SIZE:
            axis, where = _best_cut(order, a, b, lo, hi, mid, cuts, bins, run)
        if axis < 0:
            links[node, 0], links[node, 1] = a, b - a
            continue
        i, j = a, b - 1
        while i <= j:
            if mid[order[i], axis] < where:
                i += 1
            else:
                order[i], order[j] = order[j], order[i]
                j -= 1
        if i in (a, b):
            i = (a + b) // 2
        links[node, 0], links[node, 1] = used, 0
        spans[top + 1, 0], spans[top + 1, 1], spans[top + 1, 2] = used, a, i
        spans[top + 2, 0], spans[top + 2, 1], spans[top + 2, 2] = used + 1, i, b
        top += 2
        used += 2
    return used


def build_bvh(lo: NDArray, hi: NDArray) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int64]]:
    """Boxes, links and order of a hierarchy over the boxes lo, hi (N, 3).

    Binned surface area heuristic: Wald, "On fast construction of SAH-based bounding volume hierarchies", 2007.
    """
    n = len(lo)
    order = np.arange(n)
    boxes, links = np.empty((2 * n + 1, 6)), np.empty((2 * n + 1, 2), dtype=np.int32)
    work = np.empty((16, 2)), np.empty((16, 6)), np.empty((2, 6)), np.empty((256, 3), dtype=np.int64)
    used = _build(lo, hi, 0.5 * (lo + hi), order, boxes, links, *work)
    boxes = boxes[:used] + 1e-5 * np.repeat([-1.0, 1.0], 3)
    return boxes.astype(np.float32), links[:used].copy(), order


@njit(nogil=True, cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy")
def trace(
    boxes: Any,
    links: Any,
    planes: Any,
    shape: Any,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    far: float,
    any_hit: float,
    stack: Any,
) -> tuple[int, float, float, float]:
    """The nearest hit of a ray closer than ``far``: row of ``planes`` or -1, distance, u, v. any_hit > 0: any hit.

    planes: (N, 12) from ``plane_rows``, in tree order. shape: (N,) in tree order. stack: (128,) int32, work space.
    """
    tiny = 1e-12
    ix = 1.0 / (dx if abs(dx) > tiny else tiny)
    iy = 1.0 / (dy if abs(dy) > tiny else tiny)
    iz = 1.0 / (dz if abs(dz) > tiny else tiny)
    best, who, bu, bv = far, -1, 0.0, 0.0
    top = 0
    stack[0] = 0
    while top >= 0:
        node = stack[top]
        top -= 1
        ax, bx = (boxes[node, 0] - ox) * ix, (boxes[node, 3] - ox) * ix
        ay, by = (boxes[node, 1] - oy) * iy, (boxes[node, 4] - oy) * iy
        az, bz = (boxes[node, 2] - oz) * iz, (boxes[node, 5] - oz) * iz
        near = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), 0.0))
        last = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), best))
        if near > last:
            continue
        first, count = links[node, 0], links[node, 1]
        if count == 0:
            # The nearer child, by its centre along the ray, goes on top of the stack.
            c0 = (
                (boxes[first, 0] + boxes[first, 3]) * dx
                + (boxes[first, 1] + boxes[first, 4]) * dy
                + (boxes[first, 2] + boxes[first, 5]) * dz
            )
            g = first + 1
            c1 = (boxes[g, 0] + boxes[g, 3]) * dx + (boxes[g, 1] + boxes[g, 4]) * dy + (boxes[g, 2] + boxes[g, 5]) * dz
            stack[top + 1] = g if c0 < c1 else first
            stack[top + 2] = first if c0 < c1 else g
            top += 2
            continue
        for i in range(first, first + count):
            den = planes[i, 0] * dx + planes[i, 1] * dy + planes[i, 2] * dz
            t = (planes[i, 3] - (planes[i, 0] * ox + planes[i, 1] * oy + planes[i, 2] * oz)) / (
                den if abs(den) > tiny else tiny
            )
            if t <= 1e-4 or t >= best:
                continue
            x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
            u = planes[i, 4] * x + planes[i, 5] * y + planes[i, 6] * z - planes[i, 7]
            v = planes[i, 8] * x + planes[i, 9] * y + planes[i, 10] * z - planes[i, 11]
            if u < 0.0 or v < 0.0 or u > 1.0 or v > 1.0:
                continue
            s = shape[i]
            if s == TRIANGLE and u + v > 1.0:
                continue
            if s == DISC and (u - 0.5) * (u - 0.5) + (v - 0.5) * (v - 0.5) > 0.25:
                continue
            if s == LEAF and abs(v - 0.5) > 2.0 * u * (1.0 - u):
                continue
            best, who, bu, bv = t, i, u, v
            if any_hit > 0.0:
                return who, best, bu, bv
    return who, best, bu, bv


def plane_rows(p0: NDArray, normal: NDArray, dual_u: NDArray, dual_v: NDArray) -> NDArray[np.float32]:
    """(N, 12) rows for ``trace``: normal, dual edge of u and of v, each with its product with the corner ``p0``."""
    cols = []
    for vectors in (normal, dual_u, dual_v):
        cols += [vectors, np.sum(vectors * p0, axis=1, keepdims=True)]
    return np.ascontiguousarray(np.concatenate(cols, axis=1), dtype=np.float32)


@njit(nogil=True, cache=True, error_model="numpy")
def clearances(p0: Any, eu: Any, ev: Any, points: Any) -> Any:
    """Lower bound (M,) of the distance from points (M, 3) to any primitive, metres.

    Triangles, discs and leaves count as their whole parallelogram.
    """
    out = np.full(points.shape[0], 1e30)
    for i in range(p0.shape[0]):
        aa = eu[i, 0] ** 2 + eu[i, 1] ** 2 + eu[i, 2] ** 2
        bb = ev[i, 0] ** 2 + ev[i, 1] ** 2 + ev[i, 2] ** 2
        ab = eu[i, 0] * ev[i, 0] + eu[i, 1] * ev[i, 1] + eu[i, 2] * ev[i, 2]
        det = aa * bb - ab * ab
        for j in range(points.shape[0]):
            x, y, z = (
                points[j, 0] - p0[i, 0],
                points[j, 1] - p0[i, 1],
                points[j, 2] - p0[i, 2],
            )
            pa = x * eu[i, 0] + y * eu[i, 1] + z * eu[i, 2]
            pb = x * ev[i, 0] + y * ev[i, 1] + z * ev[i, 2]
            u, v = (bb * pa - ab * pb) / det, (aa * pb - ab * pa) / det
            if u < 0.0 or u > 1.0 or v < 0.0 or v > 1.0:
                # The foot point is outside: take the nearest of the four edges.
                best = 1e30
                for k in range(4):
                    if k < 2:
                        f = float(k)
                        e = min(1.0, max(0.0, (pa - f * ab) / aa))
                        s, t = e, f
                    else:
                        f = float(k - 2)
                        e = min(1.0, max(0.0, (pb - f * ab) / bb))
                        s, t = f, e
                    d2 = (
                        (x - s * eu[i, 0] - t * ev[i, 0]) ** 2
                        + (y - s * eu[i, 1] - t * ev[i, 1]) ** 2
                        + (z - s * eu[i, 2] - t * ev[i, 2]) ** 2
                    )
                    best = min(best, d2)
            else:
                best = (
                    (x - u * eu[i, 0] - v * ev[i, 0]) ** 2
                    + (y - u * eu[i, 1] - v * ev[i, 1]) ** 2
                    + (z - u * eu[i, 2] - v * ev[i, 2]) ** 2
                )
            out[j] = min(out[j], best)
    return np.sqrt(out)

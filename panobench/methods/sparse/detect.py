"""Shi-Tomasi corners, spread evenly over the view."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.methods.sparse.faces import FaceSet

Array = NDArray[np.float64]

#: Least corner response: the smaller eigenvalue of the mean structure tensor, for grey values in 0..255.
MIN_RESPONSE = 1.5
BLOCK = 5


def detect_corners(
    face_set: FaceSet, faces: NDArray[np.uint8], wanted: int, occupied: Array, spacing: float | None = None
) -> Array:
    """Unit bearings (N, 3) of at most ``wanted`` new corners, away from the bearings ``occupied`` (M, 3).

    spacing: least distance of two corners in pixels. By default it follows from the area and the number wanted.
    """
    area = int(face_set.core.sum())
    if wanted <= 0 or area == 0:
        return np.empty((0, 3))
    if spacing is None:
        spacing = float(np.clip(0.5 * np.sqrt(area / max(1, wanted + len(occupied))), 4.0, 30.0))
    found: list[Array] = []
    strength: list[Array] = []
    cell = max(8, int(2.5 * spacing))
    for f in range(face_set.count):
        response = cv2.cornerMinEigenVal(faces[f], BLOCK, ksize=3)
        response *= 255.0**2  # OpenCV scales 8-bit images to 0..1
        free = face_set.core[f].astype(np.uint8)
        _mask_occupied(free, face_set, f, occupied, spacing)
        response[free == 0] = 0.0
        top = cv2.dilate(response, np.ones((5, 5), np.uint8))
        v, u = np.nonzero((response == top) & (response > MIN_RESPONSE))
        if len(u) == 0:
            continue
        s = response[v, u]
        order = np.argsort(-s, kind="stable")
        u, v, s = u[order], v[order], s[order]
        # Rank within the grid cell: the best corner of every cell comes before the second best of any.
        key = (v // cell) * 4096 + u // cell
        rank = _rank_within(key)
        du, dv = _subpixel(response, u, v)
        pixels = np.column_stack([u + 0.5 + du, v + 0.5 + dv])
        found.append(np.column_stack([pixels, np.full(len(u), f), rank]))
        strength.append(s)
    if not found:
        return np.empty((0, 3))
    table, s = np.concatenate(found), np.concatenate(strength)
    order = np.lexsort((-s, table[:, 3]))
    chosen = _suppress_neighbours(table[order], spacing, wanted, face_set)
    out = np.empty((len(chosen), 3))
    for f in range(face_set.count):
        mine = chosen[:, 2] == f
        if mine.any():
            out[mine] = face_set.rays(f, chosen[mine, :2])
    return out


def _mask_occupied(free: NDArray[np.uint8], face_set: FaceSet, face: int, occupied: Array, spacing: float) -> None:
    if len(occupied) == 0:
        return
    fx, fy, cx, cy = face_set.intrinsics
    p = occupied @ face_set.R_fc[face].T
    p = p[p[:, 2] > 0.3]
    for u, v in zip(fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy):
        if -spacing < u < free.shape[1] + spacing and -spacing < v < free.shape[0] + spacing:
            cv2.circle(free, (int(u), int(v)), int(spacing), (0,), -1)


def _rank_within(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each element, how many earlier ones have the same key."""
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    start = np.searchsorted(sorted_key, sorted_key)
    rank = np.empty(len(key), np.int64)
    rank[order] = np.arange(len(key)) - start
    return rank


def _subpixel(response: NDArray[np.float32], u: NDArray[np.int64], v: NDArray[np.int64]) -> tuple[Array, Array]:
    """Offsets of the peak, per axis, by a parabola through the response and its neighbours; at most half a pixel."""
    h, w = response.shape
    u0, u1 = np.maximum(u - 1, 0), np.minimum(u + 1, w - 1)
    v0, v1 = np.maximum(v - 1, 0), np.minimum(v + 1, h - 1)
    c = response[v, u].astype(np.float64)

    def peak(a: NDArray[Any], b: NDArray[Any]) -> Array:
        curve = a - 2 * c + b
        return np.asarray(np.clip(0.5 * (a - b) / np.where(curve < -1e-9, curve, -1e9), -0.5, 0.5))

    return peak(response[v, u0], response[v, u1]), peak(response[v0, u], response[v1, u])


def _suppress_neighbours(table: Array, spacing: float, wanted: int, face_set: FaceSet) -> Array:
    """Non-maximum suppression: a corner is kept if no better one is within ``spacing`` on its face."""
    h, w = face_set.size
    taken = np.zeros((face_set.count, h, w), np.uint8)
    kept = []
    for row in table:
        u, v, f = int(row[0]), int(row[1]), int(row[2])
        u, v = min(max(u, 0), w - 1), min(max(v, 0), h - 1)
        if taken[f, v, u]:
            continue
        cv2.circle(taken[f], (u, v), int(spacing), (1,), -1)
        kept.append(row)
        if len(kept) >= wanted:
            break
    return np.array(kept).reshape(-1, 4)

"""The ring of valid pixels of a panoramic annular lens, for programs that take two circles instead of a mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Annulus:
    """Two circles about (x, y), in pixels with the first pixel's centre at 0. ``inner`` is 0 without a hole.

    mismatch: share of the image's pixels that lie in the ring and are not valid, or the other way round.
    """

    x: float
    y: float
    inner: float
    outer: float
    mismatch: float = 0.0


def fit_annulus(valid: Mask, x: float, y: float) -> Annulus:
    """The ring that describes valid pixels (H, W) best; ``x`` and ``y`` are the lens's centre.

    The hole is the invalid region around the centre, the outside are the invalid regions at the image's border. Both
    edges are fitted by circles with one centre (linear least squares, as Kasa 1976). An edge that does not exist
    leaves 0 or the distance of the farthest corner.
    """
    import cv2

    height, width = valid.shape
    corner = max(float(np.hypot(u - x, v - y)) for u in (0, width - 1) for v in (0, height - 1))
    _, labels = cv2.connectedComponents((~valid).astype(np.uint8), connectivity=4)
    row, column = np.clip([round(y), round(x)], 0, [height - 1, width - 1])
    hole = labels[row, column] if not valid[row, column] else -1
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    outside = np.isin(labels, border[(border != hole) & (border > 0)])
    inner_edge, outer_edge = _edge(labels == hole, valid), _edge(outside, valid)
    ring = _fit(inner_edge, outer_edge, x, y, corner)
    v, u = np.mgrid[:height, :width]
    distance = np.hypot(u - ring.x, v - ring.y)
    drawn = (distance <= ring.outer) & ((distance > ring.inner) | (ring.inner == 0))
    return Annulus(ring.x, ring.y, ring.inner, ring.outer, float(np.mean(drawn != valid)))


def _edge(region: Mask, valid: Mask) -> NDArray[np.float64]:
    """Points (N, 2) as (u, v) half-way between a pixel of ``region`` and a valid neighbour."""
    points = []
    for axis, step in ((1, (0.5, 0.0)), (0, (0.0, 0.5))):
        a, b = np.moveaxis(region, axis, 0), np.moveaxis(valid, axis, 0)
        touching = np.moveaxis((a[:-1] & b[1:]) | (b[:-1] & a[1:]), 0, axis)
        v, u = np.nonzero(touching)
        points.append(np.stack([u + step[0], v + step[1]], axis=1))
    return np.concatenate(points)


def _fit(inner: NDArray[np.float64], outer: NDArray[np.float64], x: float, y: float, corner: float) -> Annulus:
    """Circles |p - c|^2 = r_k^2 with a common centre: linear in c and in r_k^2 - |c|^2."""
    edges = [edge for edge in (inner, outer) if len(edge) >= 8]
    if not edges:
        return Annulus(x, y, 0.0, corner)
    which = np.repeat(np.arange(len(edges)), [len(e) for e in edges])
    points = np.concatenate(edges)
    A = np.concatenate([2 * points, np.eye(len(edges))[which]], axis=1)
    solution = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)[0]
    centre = solution[:2]
    radii = np.sqrt(np.maximum(solution[2:] + centre @ centre, 0.0)).tolist()
    found_inner = radii[0] if len(inner) >= 8 else 0.0
    found_outer = radii[-1] if len(outer) >= 8 else corner
    return Annulus(float(centre[0]), float(centre[1]), found_inner, found_outer)

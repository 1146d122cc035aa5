"""Cells and portals: which primitives of a building can be seen from a point, so that a frame draws only those.

A building is cut into cells (rooms, corridors) that touch at portals (flat openings). From a point, another cell can be
seen only through portals, so the cells are walked from the point's own through every portal that is left when it is
clipped to what the portals before it show. Luebke and Georges, "Portals and mirrors" (1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.rooms.mesh import Mesh

Array = NDArray[np.float64]

#: A point this close to a cell, or to the plane of a portal, counts as in it: metres. Half a wall is thinner.
NEAR = 0.12


@dataclass(frozen=True)
class Portal:
    """A flat convex opening, corners (4, 3) in metres, between two cells by their numbers."""

    cells: tuple[int, int]
    corners: Array


class Cells:
    """The cells of a mesh."""

    def __init__(self, lo: Array, hi: Array, portals: list[Portal], member: NDArray[np.int32], mesh: Mesh) -> None:
        """lo, hi (C, 3): boxes of the cells, metres. member (N,): each primitive's cell; -1: seen from everywhere."""
        self.lo, self.hi, self.portals = lo, hi, portals
        self._middle = mesh.p0 + 0.5 * (mesh.eu + mesh.ev)
        diagonals = np.linalg.norm(np.stack([mesh.eu + mesh.ev, mesh.eu - mesh.ev]), axis=-1)
        self._radius = 0.5 * diagonals.max(axis=0)
        self._members = [np.flatnonzero(member == k) for k in range(len(lo))]
        self._everywhere = member == -1
        self._ways = [_Ways([p for p in portals if k in p.cells], k) for k in range(len(lo))]

    def around(self, point: Array) -> list[int]:
        """The cells that a point (3,) is in, or hardly outside of."""
        inside = np.all((point >= self.lo - NEAR) & (point <= self.hi + NEAR), axis=1)
        return [int(k) for k in np.flatnonzero(inside)]

    def primitives(self, point: Array) -> NDArray[np.int32]:
        """Numbers of the primitives that may be seen from a point (3,), in their order; outside of all cells: all."""
        start = self.around(point)
        seen = self._everywhere.copy() if start else np.ones(len(self._everywhere), dtype=bool)
        for cell in start:
            self._look(point, cell, np.zeros((0, 3)), seen, [])
        return np.flatnonzero(seen).astype(np.int32)

    def _look(self, point: Array, cell: int, planes: Array, seen: NDArray[np.bool_], path: list[int]) -> None:
        """Add what is seen of a cell, and of those behind its portals.

        planes (P, 3): unit normals, inwards, of the planes through the point within which the cell is seen.
        """
        mine = self._members[cell]
        if len(planes):
            inside = (self._middle[mine] - point) @ planes.T > -self._radius[mine, None]
            mine = mine[inside.all(axis=1)]
        seen[mine] = True
        ways = self._ways[cell]
        for k in ways.ahead(point, planes):
            if ways.others[k] in path:
                continue
            corners = ways.portals[k].corners - point
            if _passes(corners):
                beyond = planes
            else:
                shown = _clipped(corners, planes)
                if len(shown) < 3:
                    continue
                beyond = _planes(shown)
            self._look(point, ways.others[k], beyond, seen, [*path, cell])


class _Ways:
    """The portals of one cell, and the cells that they lead to."""

    def __init__(self, portals: list[Portal], cell: int) -> None:
        self.portals = portals
        self.others = [p.cells[p.cells[0] == cell] for p in portals]
        corners = np.array([p.corners for p in portals]).reshape(len(portals), -1, 3)
        self._middle = corners.mean(axis=1)
        self._radius = np.linalg.norm(corners - self._middle[:, None], axis=-1).max(axis=1)

    def ahead(self, point: Array, planes: Array) -> list[int]:
        """Those that may be on the inner side of all planes (P, 3) through a point (3,)."""
        inside = (self._middle - point) @ planes.T > -self._radius[:, None]
        return [int(k) for k in np.flatnonzero(inside.all(axis=1))]


def _passes(corners: Array) -> bool:
    """Whether the origin is so close to a portal's plane that its outline tells nothing."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return abs(float(normal @ corners[0])) < NEAR * float(np.linalg.norm(normal))


def _clipped(corners: Array, planes: Array) -> Array:
    """What is left (K, 3) of a polygon on the inner side of all planes through the origin."""
    for normal in planes:
        side = corners @ normal
        kept: list[Array] = []
        for a, b, sa, sb in zip(corners, np.roll(corners, -1, axis=0), side, np.roll(side, -1)):
            if sa >= 0:
                kept.append(a)
            if sa * sb < 0:
                kept.append(a + (b - a) * (sa / (sa - sb)))
        corners = np.array(kept).reshape(-1, 3)
        if len(corners) < 3:
            break
    return corners


def _planes(corners: Array) -> Array:
    """Normals (K, 3) of the planes through the origin and the edges of a convex polygon, towards its middle."""
    normals = np.cross(corners, np.roll(corners, -1, axis=0))
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-12] / lengths[lengths > 1e-12, None]
    return normals * np.sign(normals @ corners.mean(axis=0))[:, None]

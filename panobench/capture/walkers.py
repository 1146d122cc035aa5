"""People who walk about a room: paths over the floor that is free, at a walking pace, seen where nothing hides them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from panobench.capture.person import Looks, Posture, person
from panobench.capture.solids import Solids, joined
from panobench.geometry import distances_along
from panobench.rooms.mesh import Mesh
from panobench.rooms.trace import clearances

Array = NDArray[np.float64]

#: Metres of floor per cell, and what a person keeps from everything.
CELL, CLEARANCE = 0.15, 0.26
#: Metres per second, metres per full stride.
PACE, STRIDE = 0.8, 1.3
#: Metres that a path should stay away from the camera, horizontally.
AWAY = 0.6


@dataclass(frozen=True)
class Floor:
    """Cells (rows along y, columns along x) where a person fits; ``corner``: world x, y of cell (0, 0)'s centre."""

    free: NDArray[np.bool_]
    corner: Array

    @classmethod
    def of(cls, mesh: Mesh, camera: Array) -> Floor:
        """The free floor at z = 0 that is connected to what lies below a camera's places (N, 3)."""
        ends = np.concatenate([mesh.p0, mesh.p0 + mesh.eu + mesh.ev])
        low, high = ends[:, :2].min(axis=0) + CELL, ends[:, :2].max(axis=0)
        x, y = np.arange(low[0], high[0], CELL), np.arange(low[1], high[1], CELL)
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        free = np.ones(len(grid), dtype=bool)
        for z in (0.35, 0.8, 1.3, 1.7):
            at = np.column_stack([grid[free], np.full(int(free.sum()), z)])
            free[free] = clearances(mesh.p0, mesh.eu, mesh.ev, np.ascontiguousarray(at)) > CLEARANCE
        cells = free.reshape(len(y), len(x))
        parts, count = label(cells, structure=np.ones((3, 3)))
        if count > 1:  # outside the windows there is floor too
            row, column = np.nonzero(cells)
            nearest = cKDTree(low + CELL * np.column_stack([column, row])).query(camera[:, :2])[1]
            cells = parts == np.bincount(parts[row[nearest], column[nearest]]).argmax()
        return cls(cells, low)

    @cached_property
    def places(self) -> Array:
        """World x, y of the free cells (N, 2)."""
        row, column = np.nonzero(self.free)
        return np.asarray(self.corner + CELL * np.column_stack([column, row]))

    @cached_property
    def _graph(self) -> coo_matrix:
        number: NDArray[np.int64] = np.full(self.free.shape, -1)
        number[self.free] = np.arange(int(self.free.sum()))
        rows, columns, lengths = [], [], []
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = number[: number.shape[0] - dy, max(0, -dx) : number.shape[1] - max(0, dx)]
            b = number[dy:, max(0, dx) : number.shape[1] + min(0, dx)]
            both = (a >= 0) & (b >= 0)
            rows.append(a[both])
            columns.append(b[both])
            lengths.append(np.full(int(both.sum()), CELL * np.hypot(dx, dy)))
        n = len(self.places)
        return coo_matrix((np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n))

    def walk(self, length: float, rng: np.random.Generator) -> Array:
        """A smooth path (N, 2) between random places, at least ``length`` metres long, a point every centimetre."""
        graph, points, done = self._graph.tocsr(), [], 0.0
        here = int(rng.integers(len(self.places)))
        while done < length:
            distance, before = dijkstra(graph, directed=False, indices=here, return_predecessors=True)
            reachable = np.flatnonzero(np.isfinite(distance) & (distance > min(1.0, 0.5 * distance.max())))
            there = int(rng.choice(reachable)) if len(reachable) else here
            path = [there]
            while path[-1] != here and before[path[-1]] >= 0:
                path.append(int(before[path[-1]]))
            points.append(self.places[path[::-1]])
            done += max(float(distance[there]), 0.05)
            here = there
        p = np.concatenate(points)
        p = gaussian_filter1d(_even(p, 0.01), 18.0, axis=0, mode="nearest")
        return _even(p, 0.01)


def _even(p: Array, step: float) -> Array:
    """A polyline (N, 2) at even distances along it."""
    s = distances_along(p)
    at = np.arange(0.0, s[-1] + step, step)
    return np.column_stack([np.interp(at, s, p[:, k]) for k in range(2)])


class Walkers:
    """``solids(t)``: the people of a room in the world's axes (z up), their paths chosen to keep from the camera."""

    def __init__(self, floor: Floor, camera: Array, times: Array, count: int, seed: int = 0) -> None:
        """``camera`` (N, 3): where the camera is at ``times`` (N,)."""
        self._looks, self._paths, self._phase = [], [], []
        self._begin = float(times[0])
        for k in range(count):
            rng = np.random.default_rng([seed, 79, k])
            self._looks.append(Looks.random(rng))
            self._phase.append(float(rng.uniform(0, 2 * np.pi)))
            length = PACE * float(times[-1] - times[0]) + 1.0
            best, furthest = np.zeros((1, 2)), -1.0
            for _ in range(40):
                path = floor.walk(length, rng)
                at = path[np.clip((PACE * (times - self._begin) / 0.01).astype(int), 0, len(path) - 1)]
                away = float(np.linalg.norm(at - camera[:, :2], axis=1).min())
                if away > furthest:
                    best, furthest = path, away
                if away > AWAY:
                    break
            self._paths.append(best)

    def solids(self, t: float) -> Solids:
        return joined([self._one(k, t) for k in range(len(self._paths))])

    def _one(self, k: int, t: float) -> Solids:
        path = self._paths[k]
        s = np.clip(PACE * (t - self._begin) / 0.01, 0.0, len(path) - 2.0)
        i = int(s)
        place = path[i] + (s - i) * (path[i + 1] - path[i])
        a, b = path[max(i - 15, 0)], path[min(i + 15, len(path) - 1)]
        ahead = b - a
        heading = np.arctan2(ahead[1], ahead[0]) - np.pi / 2
        stride = 2 * np.pi * s * 0.01 / STRIDE + self._phase[k]
        posture = Posture(
            stride=stride,
            lean=(0.04, 0.02 * np.sin(stride)),
            head=(0.3 * np.sin(0.7 * t + self._phase[k]), 0.05),
        )
        c, s_ = np.cos(heading), np.sin(heading)
        T = np.eye(4)
        T[:3, :3] = [[c, -s_, 0], [s_, c, 0], [0, 0, 1]]
        T[:3, 3] = [place[0], place[1], 0.02 * abs(np.cos(stride))]
        return person(self._looks[k], posture).moved(T)

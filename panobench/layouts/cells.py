"""Where directions lie in pictures that pack the sphere otherwise than as a panorama: cubemaps of all kinds, fisheyes.

A packing maps unit directions (..., 3), x right, y down, z forward, to places (..., 2) in the picture, each from 0 to 1
from its upper left corner, and says which it holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.views import view_rotation
from panobench.geometry import lonlat_from_directions

Array = NDArray[np.float64]


class Packing(Protocol):
    """How a picture holds the sphere."""

    @property
    def proportions(self) -> float:
        """Width over height."""

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of parts that do not continue each other."""

    @property
    def turns(self) -> float:
        """How often its width goes round the horizon, at the resolution of its middle: 1 for a panorama."""

    def locate(self, directions: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Places of directions (..., 3) as (..., 2), and which are in the picture (...)."""


@dataclass(frozen=True)
class Panorama:
    """Longitudes along the width and latitudes along the height; ``crop``: the part of the full sphere's picture that
    is there, as left, top, right and bottom edge from 0 to 1.
    """

    crop: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    grid = (1, 1)

    @property
    def proportions(self) -> float:
        left, top, right, bottom = self.crop
        return 2 * (right - left) / (bottom - top)

    @property
    def turns(self) -> float:
        return self.crop[2] - self.crop[0]

    def locate(self, directions: Array) -> tuple[Array, NDArray[np.bool_]]:
        lon, lat = lonlat_from_directions(directions)
        left, top, right, bottom = self.crop
        u, v = 0.5 + lon / (2 * np.pi), 0.5 - lat / np.pi
        if right > 1:  # it goes on beyond the seam
            u = np.where(u < left, u + 1, u)
        place = np.stack([(u - left) / (right - left), (v - top) / (bottom - top)], axis=-1)
        return place, np.asarray(((place >= 0) & (place <= 1)).all(axis=-1))


@dataclass(frozen=True)
class Cube:
    """Six faces in a grid. cells: rows of (face, quarter turns clockwise by which it is stored), None where nothing is.

    equiangular: pixels are at equal angles within a face (EAC), not on a plane. pad_px: pixels at the left and right
    edge of the picture, and above and below each row, that repeat others (the EAC of FFmpeg and YouTube); pad: the same
    as shares of a picture's width and height, once its size is known.
    """

    cells: tuple[tuple[tuple[str, int] | None, ...], ...]
    equiangular: bool = False
    pad_px: int = 0
    pad: tuple[float, float] = (0.0, 0.0)

    @property
    def proportions(self) -> float:
        return len(self.cells[0]) / len(self.cells)

    @property
    def grid(self) -> tuple[int, int]:
        return len(self.cells[0]), len(self.cells)

    @property
    def turns(self) -> float:
        return len(self.cells[0]) / 4

    def locate(self, directions: Array) -> tuple[Array, NDArray[np.bool_]]:
        rows, columns = len(self.cells), len(self.cells[0])
        places = [(r, c, *cell) for r, row in enumerate(self.cells) for c, cell in enumerate(row) if cell is not None]
        R = np.stack([view_rotation(face) for _, _, face, _ in places])
        k = np.argmax(directions @ R[:, 2].T, axis=-1)
        q = (R[k] @ directions[..., None])[..., 0]
        ab = q[..., :2] / q[..., 2:]
        if self.equiangular:
            ab = np.arctan(ab) * (4 / np.pi)
        ab = np.clip(ab, -1, 1)
        turn = np.array([t for *_, t in places])[k][..., None]
        turned = [ab, np.stack([-ab[..., 1], ab[..., 0]], -1), -ab, np.stack([ab[..., 1], -ab[..., 0]], -1)]
        stored = np.select([turn == t for t in range(4)], turned)
        corner = np.array([(c, r) for r, c, *_ in places], dtype=float)[k]
        inside = (stored + 1) / 2
        u = (corner[..., 0] + inside[..., 0]) / columns * (1 - 2 * self.pad[0]) + self.pad[0]
        v = (corner[..., 1] + inside[..., 1] * (1 - 2 * rows * self.pad[1])) / rows + self.pad[1]
        return np.stack([u, v], axis=-1), np.ones(u.shape, dtype=bool)


@dataclass(frozen=True)
class TwoFisheyes:
    """Two circles side by side, equidistant lenses back to back: the left looks ahead and the right behind.

    rim_deg: full angle from rim to rim; the circle touches the edges of its half.
    """

    rim_deg: float = 190.0

    proportions = 2.0
    grid = (2, 1)

    @property
    def turns(self) -> float:
        return self.rim_deg * 2 / 360

    def locate(self, directions: Array) -> tuple[Array, NDArray[np.bool_]]:
        behind = directions[..., 2] < 0
        z = np.abs(directions[..., 2])
        x = np.where(behind, -directions[..., 0], directions[..., 0])
        h = np.hypot(x, directions[..., 1])
        radius = np.arctan2(h, z) / np.deg2rad(self.rim_deg)  # of the half's width
        with np.errstate(invalid="ignore", divide="ignore"):
            u = 0.5 + radius * np.where(h > 0, x / h, 0.0)
            v = 0.5 + radius * np.where(h > 0, directions[..., 1] / h, 0.0)
        place = np.stack([(u + behind) / 2, v], axis=-1)
        return place, np.asarray(radius <= 0.5)


def _row(names: str, turns: tuple[int, ...] = (0, 0, 0, 0, 0, 0)) -> tuple[tuple[str, int], ...]:
    letters = {"l": "left", "f": "front", "r": "right", "d": "down", "b": "back", "u": "up"}
    return tuple((letters[name], turn) for name, turn in zip(names, turns))


#: YouTube's equi-angular cubemap, which GoPro records, too.
EAC = Cube((_row("lfr"), _row("dbu", (3, 1, 3))), equiangular=True, pad_px=2)
#: FFmpeg's order in three columns, in a row and in a column; a row as ``cameras.cubemap`` has it; crosses.
CUBE_3X2 = Cube((_row("rlu"), _row("dfb")))
CUBE_6X1 = Cube((_row("rludfb"),))
CUBE_1X6 = Cube(tuple((cell,) for cell in _row("rludfb")))
CUBE_STRIP = Cube((_row("frblud"),))
CUBE_CROSS = Cube(((None, ("up", 0), None, None), _row("lfrb"), (None, ("down", 0), None, None)))

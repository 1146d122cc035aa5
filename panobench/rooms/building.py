"""The frame of a building: spaces on several floors, and the openings between them, as cells and portals.

Spaces are boxes that stand WALL apart. A link cuts an opening into the two walls between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.rooms.builder import Builder
from panobench.rooms.cells import Cells, Portal
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Mesh
from panobench.rooms.shell import Room, build_shell

Array = NDArray[np.float64]
Furnish = Callable[[Builder, Room], None]

WALL = 0.16  # metres between two spaces
OPPOSITE = {"south": "north", "north": "south", "east": "west", "west": "east"}
#: How far apart spaces may be to be linked, and a little more.
TOUCHING = WALL + 1e-6


@dataclass
class Space:
    """A room, corridor, stairwell or court, and the height of its floor.

    furnish: called in the floor's frame. shell: whether ``build_shell`` builds it before; a court builds its own.
    """

    room: Room
    z: float
    furnish: Furnish
    shell: bool = True


@dataclass(frozen=True)
class Link:
    """An opening between two spaces. at: its middle along the wall, in world axes; bottom, top: heights in the world.

    kind: that of the opening on the first space's side; on the other it is the same hole, with nothing in it.
    """

    spaces: tuple[str, str]
    side: str
    at: float
    width: float
    bottom: float
    top: float
    kind: str


class Building:
    """Collects spaces and links, and builds them."""

    def __init__(self, b: Builder) -> None:
        self.b = b
        self.spaces: dict[str, Space] = {}
        self.links: list[Link] = []

    def add(self, name: str, space: Space) -> None:
        self.spaces[name] = space

    def link(
        self,
        first: str,
        second: str,
        at: float,
        *,
        width: float = 1.05,
        floor: float | None = None,
        sill: float = 0.0,
        height: float = 2.1,
        kind: str = "doorway",
    ) -> None:
        """Cut an opening ``at`` along the wall where the first space meets the second.

        floor: height from which sill and height count; None: that of the first space. Raises ValueError for spaces
        that do not meet: a bug in the plan.
        """
        a, c = self.spaces[first], self.spaces[second]
        base = a.z if floor is None else floor
        side = _meeting(a.room, c.room)
        link = Link((first, second), side, at, width, base + sill, base + height, kind)
        self.links.append(link)
        a.room.openings.setdefault(side, []).append(_opening(a, side, link, kind))
        c.room.openings.setdefault(OPPOSITE[side], []).append(_opening(c, OPPOSITE[side], link, "passage"))

    def build(self) -> None:
        """Build every space in its own cell."""
        for number, space in enumerate(self.spaces.values()):
            with self.b.cell(number), self._floor(space):
                if space.shell:
                    build_shell(self.b, space.room)
                space.furnish(self.b, space.room)

    def cells(self, mesh: Mesh) -> Cells:
        """Cells and portals of what has been built into a mesh."""
        number = {name: k for k, name in enumerate(self.spaces)}
        rooms = [(s.room, s.z) for s in self.spaces.values()]
        lo = np.array([[r.x0, r.y0, z] for r, z in rooms]) - WALL / 2
        hi = np.array([[r.x1, r.y1, z + r.height] for r, z in rooms]) + WALL / 2
        portals = []
        for link in self.links:
            a, c = link.spaces
            portals.append(Portal((number[a], number[c]), _outline(self.spaces[a].room, link)))
        return Cells(lo, hi, portals, self.b.members, mesh)

    @contextmanager
    def _floor(self, space: Space) -> Iterator[None]:
        with self.b.at(0.0, 0.0, space.z):
            yield


def _meeting(a: Room, c: Room) -> str:
    """The side of ``a`` at which ``c`` is."""
    gaps = {"north": c.y0 - a.y1, "south": a.y0 - c.y1, "east": c.x0 - a.x1, "west": a.x0 - c.x1}
    beside = {"x": a.x0 < c.x1 and c.x0 < a.x1, "y": a.y0 < c.y1 and c.y0 < a.y1}
    for side, gap in gaps.items():
        if -1e-6 < gap < TOUCHING and beside["x" if side in ("north", "south") else "y"]:
            return side
    raise ValueError("spaces meet at no side")


def _along(room: Room, side: str, at: float) -> float:
    """A world coordinate along a wall in the wall's frame (see ``fixtures``)."""
    return {"south": at - room.x0, "east": at - room.y0, "north": room.x1 - at, "west": room.y1 - at}[side]


def _opening(space: Space, side: str, link: Link, kind: str) -> Opening:
    middle = _along(space.room, side, link.at)
    half = link.width / 2
    return Opening(kind, middle - half, middle + half, link.bottom - space.z, link.top - space.z, WALL)


def _outline(room: Room, link: Link) -> Array:
    """Corners (4, 3) of a link's opening, in the middle of the wall."""
    a, c = link.at - link.width / 2, link.at + link.width / 2
    z = (link.bottom, link.bottom, link.top, link.top)
    if link.side in ("south", "north"):
        y = room.y1 + WALL / 2 if link.side == "north" else room.y0 - WALL / 2
        return np.array([[a, y, z[0]], [c, y, z[1]], [c, y, z[2]], [a, y, z[3]]])
    x = room.x1 + WALL / 2 if link.side == "east" else room.x0 - WALL / 2
    return np.array([[x, a, z[0]], [x, c, z[1]], [x, c, z[2]], [x, a, z[3]]])

"""The shell of a room: floor, ceiling, four walls with openings; furniture and pictures along the walls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material

SIDES = ("south", "east", "north", "west")


@dataclass
class Item:
    """A piece of furniture for a wall: its size with clearances, metres, and the function that builds it."""

    width: float
    depth: float
    height: float
    make: Callable[[Builder], None]


@dataclass
class Room:
    """A box [x0, x1] x [y0, y1] x [0, height], metres, with materials and openings per side, in wall coordinates.

    depth: of window reveals. sky: radiance outside. view: texture of the backdrop. own_view: whether the room builds
    the backdrops behind its windows; otherwise the plan does.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    height: float
    wall: dict[str, Material]
    floor: Material
    ceiling: Material
    door: Material
    openings: dict[str, list[Opening]] = field(default_factory=dict)
    depth: float = 0.22
    skirting: Material = fx.WHITE
    sky: float = 3.0
    view: str = "outdoors"
    own_view: bool = True

    @property
    def width(self) -> float:
        return self.x1 - self.x0

    @property
    def breadth(self) -> float:
        return self.y1 - self.y0

    def length(self, side: str) -> float:
        """Length of a wall, metres."""
        return self.width if side in ("south", "north") else self.breadth

    @contextmanager
    def frame(self, b: Builder, side: str) -> Iterator[None]:
        """Build in the wall frame of a side (see ``fixtures``)."""
        corner = {
            "south": (self.x0, self.y0),
            "east": (self.x1, self.y0),
            "north": (self.x1, self.y1),
            "west": (self.x0, self.y1),
        }
        with b.at(*corner[side], 0.0, SIDES.index(side) * np.pi / 2):
            yield


def build_shell(b: Builder, room: Room) -> None:
    """Build floor, ceiling, walls, and everything in the openings."""
    w, d, h = room.width, room.breadth, room.height
    b.quad(
        (room.x0, room.y0, 0),
        (w, 0, 0),
        (0, d, 0),
        room.floor,
        spacing=0.75 * b.node_spacing,
        along_v=w < d,
        origin=(0.0, 0.0),
    )
    b.quad((room.x0, room.y0, h), (0, d, 0), (w, 0, 0), room.ceiling, spacing=1.7 * b.node_spacing)
    for side in SIDES:
        holes = room.openings.get(side, [])
        with room.frame(b, side):
            fx.wall(b, room.length(side), h, room.wall[side], holes, room.depth)
            fx.skirting(b, room.length(side), holes, room.skirting)
            for o in holes:
                if o.kind == "door":
                    fx.door(b, o, room.door)
                    fx.socket(b, o.x0 - 0.2, 1.1)
                elif o.kind == "window":
                    fx.window(b, o, room.depth, room.sky, panes=max(2, round((o.x1 - o.x0) / 0.75)))
                else:
                    fx.casing(b, o)
            if room.own_view and any(o.kind == "window" for o in holes):
                fx.backdrop(b, room.length(side) / 2, 15.0, room.sky, room.view)


def furnish_wall(b: Builder, room: Room, side: str, items: list[Item]) -> list[tuple[float, float, float]]:
    """Place items along a wall at random: tall ones not before windows, none before doors.

    Items that do not fit are left out. Returns (x0, x1, height) of those that stand there, in wall coordinates.
    """
    length = room.length(side)
    doors = [(o.x0 - 0.12, o.x1 + 0.12) for o in room.openings.get(side, []) if o.kind != "window"]
    windows = [(o.x0 - 0.1, o.x1 + 0.1, o.z0) for o in room.openings.get(side, []) if o.kind == "window"]
    taken: list[tuple[float, float, float]] = []
    order = [items[i] for i in b.rng.permutation(len(items))]
    for item in sorted(order, key=lambda i: -i.width):
        spots = []
        for x in np.arange(0.06, length - item.width - 0.06, 0.05):
            a, e = x, x + item.width
            if any(a < q and e > p for p, q in doors) or any(a < q + 0.06 and e > p - 0.06 for p, q, _ in taken):
                continue
            if any(a < q and e > p and item.height > z for p, q, z in windows):
                continue
            spots.append(x)
        if not spots:
            continue
        x = float(spots[int(b.rng.integers(len(spots)))])
        taken.append((x, x + item.width, item.height))
        with room.frame(b, side), b.at(x + item.width / 2, 0.02):
            item.make(b)
    return taken


def hang_pictures(
    b: Builder,
    room: Room,
    side: str,
    taken: list[tuple[float, float, float]],
    names: list[str],
    gloss: float = 0.0,
) -> None:
    """Hang pictures (names of textures) where the wall is free above low furniture. taken: from ``furnish_wall``."""
    length = room.length(side)
    blocked = [(o.x0 - 0.2, o.x1 + 0.2) for o in room.openings.get(side, [])]
    blocked += [(a, e) for a, e, h in taken if h > 1.15]
    used: list[tuple[float, float]] = []
    for name in names:
        w, h = float(b.rng.uniform(0.4, 0.85)), float(b.rng.uniform(0.4, 0.8))
        spots = [
            x
            for x in np.arange(0.15 + w / 2, length - 0.15 - w / 2, 0.05)
            if not any(x - w / 2 < q and x + w / 2 > p for p, q in blocked)
            and not any(x - w / 2 < q + 0.15 and x + w / 2 > p - 0.15 for p, q in used)
        ]
        if not spots:
            continue
        x = float(spots[int(b.rng.integers(len(spots)))])
        used.append((x - w / 2, x + w / 2))
        wood = ["walnut", "oak", "ebony", "cherry"][int(b.rng.integers(4))]
        with room.frame(b, side):
            fx.picture(
                b,
                x,
                float(b.rng.uniform(1.5, 1.65)),
                w,
                h,
                name,
                Material(wood, 0.6),
                gloss,
            )

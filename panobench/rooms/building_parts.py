"""What furnishes the spaces of a building that are not flats' rooms: corridors, stairwell, hall, court, offices."""

from __future__ import annotations

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import furniture as fu
from panobench.rooms import household as hh
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material
from panobench.rooms.plans import pick, place
from panobench.rooms.shell import SIDES, Item, Room, furnish_wall, hang_pictures

#: One storey: steps of a flight, their rise and tread, metres.
STEPS, RISE, TREAD = 9, 1.0 / 6.0, 0.289
STOREY = 2 * STEPS * RISE
LANDING, REACH = 1.64, STEPS * TREAD  # metres in front of the flights, and along them
FLIGHT = 2.0  # width of a flight, metres
RAIL = 0.9


def lamps(b: Builder, room: Room, spacing: float, power: float = 8.0) -> None:
    """Ceiling panels in a row along the longer side."""
    long_x = room.width >= room.breadth
    length = room.width if long_x else room.breadth
    n = max(1, round(length / spacing))
    for k in range(n):
        t = (k + 0.5) * length / n
        x, y = (room.x0 + t, (room.y0 + room.y1) / 2) if long_x else ((room.x0 + room.x1) / 2, room.y0 + t)
        fx.ceiling_panel(b, x, y, room.height, *((1.2, 0.3) if long_x else (0.3, 1.2)), power)


def plain_corridor(b: Builder, room: Room) -> None:
    """White walls and lamps, nothing else."""
    lamps(b, room, 4.0)


def corridor(b: Builder, room: Room) -> None:
    """Posters between the doors and a plant at an end; every storey's is the same."""
    keep, b.rng = b.rng, np.random.default_rng(7)
    lamps(b, room, 4.0)
    for k, side in enumerate(SIDES):
        if room.length(side) > 4.0:
            hang_pictures(b, room, side, [], [f"poster#{k}", f"landscape#{k}", f"poster#{k}"])
            for o in room.openings.get(side, []):
                if o.kind == "window":
                    with room.frame(b, side):
                        fx.radiator(b, (o.x0 + o.x1) / 2, 1.1)
    with b.at(room.x1 - 0.35, room.y0 + 0.35):
        small.plant(b, 1.1)
    b.rng = keep


def office(b: Builder, room: Room) -> None:
    """Two desks and shelves along the walls."""
    r, wood = b.rng, Material(pick(b.rng, "oak", "walnut", "ash", "pine"), 1.0)

    def desk(q: Builder) -> None:
        fu.desk(q, 1.3, 0.68, wood)
        with q.at(0.05, 1.1, 0, np.pi + r.uniform(-0.5, 0.5)):
            fu.office_chair(q, Material(pick(r, "fabric:52,58,70", "fabric:90,60,50", "fabric:70,80,70"), 0.8))

    outer = "south" if any(o.kind == "window" for o in room.openings.get("south", [])) else "north"
    for side in ("south", "north", "west", "east"):
        if side == outer:
            items = [Item(1.4, 1.25, 0.8, desk), Item(0.8, 0.3, 1.9, lambda q: fu.bookshelf(q, 0.8, 1.9, wood))]
        elif side in ("west", "east"):
            items = [
                Item(0.9, 0.3, 2.0, lambda q: fu.bookshelf(q, 0.9, 2.0, wood, fill=0.7)),
                Item(1.2, 0.42, 0.85, lambda q: fu.cabinet(q, 1.2, 0.85, 0.42, wood)),
            ]
        else:
            items = [Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 0.9))]
        taken = furnish_wall(b, room, side, items)
        k = int(r.integers(12))
        hang_pictures(b, room, side, taken, [f"abstract#{k}", f"poster#{k}"])
    lamps(b, room, 3.0, 9.0)


def hall(b: Builder, room: Room) -> None:
    """An entrance hall: columns, a reception desk, seats, plants, a glossy floor."""
    wood = Material("walnut", 1.0)
    x, y = (room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2
    for dx in (-4.0, 4.0):
        b.cylinder((x + dx, y, 0), 0.22, room.height, Material("stone:190,184,174", 1.2), sides=24, caps="")
    with b.at(x, room.y0 + 2.2):
        b.box((-1.6, -0.35, 0), (1.6, 0.35, 1.05), wood, skip="z")
        b.box((-1.7, -0.42, 1.05), (1.7, 0.42, 1.1), Material("stone:60,60,62", 1.0))
        small.knick_knack(b, 0.8, 0.0, 1.1)
    for side, items in {
        "west": [Item(2.2, 0.95, 0.95, lambda q: fu.sofa(q, 2.1, Material("fabric:128,76,60", 0.8), []))],
        "east": [
            Item(0.9, 0.9, 1.0, lambda q: hh.armchair(q, Material("fabric:70,92,118", 0.8))),
            Item(0.9, 0.9, 1.0, lambda q: hh.armchair(q, Material("fabric:70,92,118", 0.8))),
        ],
        "north": [Item(0.6, 0.6, 1.2, lambda q: place(q, 0.3, small.plant, 1.2)) for _ in range(4)],
    }.items():
        taken = furnish_wall(b, room, side, items)
        hang_pictures(b, room, side, taken, ["abstract#20", "landscape#20", "abstract#21"])
    for k in range(6):
        px, py = room.x0 + (k % 3 + 0.5) * room.width / 3, room.y0 + (k // 3 + 0.5) * room.breadth / 2
        fx.ceiling_panel(b, px, py, room.height, 1.2, 0.6, 8.0)


def stairwell(b: Builder, room: Room) -> None:
    """Two flights a storey round a well, with landings: as many storeys as fit under the ceiling."""
    stone, edge = Material("stone:176,172,166", 1.2), Material("metal:150,152,156", 0.5)
    x1, y0, y1 = room.x1 - LANDING, room.y0, room.y1
    x0 = x1 - REACH
    z = 0.0
    while z + STOREY < room.height:
        for k in range(STEPS):
            top = z + (k + 1) * RISE
            x = x1 - (k + 1) * TREAD
            b.box((x, y0, top - RISE), (x + TREAD, y0 + FLIGHT, top), stone, grain=1)
            x, top = x0 + k * TREAD, top + STEPS * RISE
            b.box((x, y1 - FLIGHT, top - RISE), (x + TREAD, y1, top), stone, grain=1)
        half, full = z + STEPS * RISE, z + STOREY
        b.box((room.x0, y0, half - 0.18), (x0, y1, half), stone)
        b.box((x1, y0, full - 0.18), (room.x1, y1, full), stone)
        up = [(x1, y0 + FLIGHT, z + RAIL), (x0, y0 + FLIGHT, half + RAIL)]
        on = [(x0, y1 - FLIGHT, half + RAIL), (x1, y1 - FLIGHT, full + RAIL)]
        for rail in (up, [up[1], on[0]], on):
            b.tube(rail, 0.022, edge, sides=8)
            for t in np.linspace(0.06, 0.94, 7):
                p = (1 - t) * np.array(rail[0]) + t * np.array(rail[1])
                b.tube([p - [0, 0, RAIL], p], 0.009, edge, sides=5)
        z = full
        fx.ceiling_panel(b, (x1 + room.x1) / 2, (y0 + y1) / 2, z - 0.19, 0.3, 1.2, 8.0)
    b.tube([(x1, y0, z + RAIL), (x1, y1 - FLIGHT, z + RAIL)], 0.022, edge, sides=8)
    for y in np.linspace(y0 + 0.2, y1 - FLIGHT, 14):
        b.tube([(x1, y, z), (x1, y, z + RAIL)], 0.009, edge, sides=5)
    fx.ceiling_panel(b, (room.x0 + room.x1) / 2, (y0 + y1) / 2, room.height, 1.2, 0.6, 9.0)
    for side, names in (("west", ["landscape#30", "abstract#30"]), ("south", ["poster#31"])):
        for storey in range(round(z / STOREY) + 1):
            with b.at(0, 0, storey * STOREY):
                hang_pictures(b, room, side, [], names)


def court(b: Builder, room: Room) -> None:
    """A paved court under the sky: facades with windows, beds with shrubs, trees, benches."""
    b.quad((room.x0, room.y0, 0), (room.width, 0, 0), (0, room.breadth, 0), room.floor, spacing=0.12, origin=(0, 0))
    for side in SIDES:
        with room.frame(b, side):
            fx.wall(b, room.length(side), room.height, room.wall[side], room.openings.get(side, []), room.depth)
            for o in room.openings.get(side, []):
                _surround(b, o)
    bark, soil = Material("walnut", 0.6), Material("carpet:74,58,44", 1.0)
    green = [Material("leaves:96,128,70", 0.7), Material("leaves:120,140,80", 0.7)]
    for x, y in ((0.2, 0.22), (0.8, 0.22), (0.2, 0.8), (0.8, 0.8)):
        with b.at(room.x0 + x * room.width, room.y0 + y * room.breadth, 0.0, b.rng.uniform(0, 6)):
            b.box((-0.7, -0.7, 0), (0.7, 0.7, 0.4), Material("brick:150,96,76", 1.0), skip="zZ")
            b.quad((-0.7, -0.7, 0.38), (1.4, 0, 0), (0, 1.4, 0), soil)
            b.cylinder((0, 0, 0.38), 0.09, 2.2, bark, sides=10, caps="")
            for _ in range(6):
                at = b.rng.normal(size=3) * [0.45, 0.45, 0.35] + [0, 0, 3.0]
                size = b.rng.uniform(0.4, 0.7)
                shape = (size, size, 0.8 * size)
                b.blob(at, shape, green[int(b.rng.integers(2))], square=0.9, rows=8, sides=14, dent=0.3)
    for x in (0.42, 0.62):
        with b.at(room.x0 + x * room.width, room.y1 - 1.0):
            fu.table(b, 1.6, 0.45, 0.45, Material("pine", 1.0))
    area = (room.width, 0, 0), (0, room.breadth, 0)
    b.rect_light((room.x0, room.y0, room.height), area[1], area[0], np.array([1.5, 1.75, 2.1]))


def _surround(b: Builder, o: Opening) -> None:
    """Stone round a window of a facade."""
    stone, t, w = Material("stone:206,200,188", 1.0), 0.03, 0.1
    b.box((o.x0 - w, 0, o.z1), (o.x1 + w, t, o.z1 + w), stone, skip="y")
    if o.z0 > 0.3 + STOREY * round(o.z0 / STOREY - 0.3):
        b.box((o.x0 - w, 0, o.z0 - w), (o.x1 + w, t, o.z0), stone, skip="y")
    for x in (o.x0 - w, o.x1):
        b.box((x, 0, o.z0), (x + w, t, o.z1), stone, skip="y")

"""Plans of flats: 2 x 2 rooms joined in a ring by open doorways, and a walk round through all of them."""

from __future__ import annotations

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import furniture as fu
from panobench.rooms import household as hh
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material
from panobench.rooms.plans import Plan, pick, place, unit
from panobench.rooms.shell import SIDES, Item, Room, build_shell, furnish_wall, hang_pictures

WALL = 0.16  # thickness between rooms, metres
DOORWAY = 1.05  # width, metres


def _living(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    r = b.rng
    cover = Material(pick(r, "fabric:70,92,118", "fabric:128,76,60", "fabric:96,110,88"), 0.8)
    pillows = [Material(pick(r, "fabric:200,156,64", "fabric:180,80,70", "check:90,120,140"), 0.8) for _ in range(3)]
    a = furnish_wall(b, room, outer[0], [
        Item(2.2, 0.95, 0.95, lambda q: fu.sofa(q, 2.1, cover, pillows)),
        Item(0.5, 0.5, 1.7, lambda q: place(q, 0.3, small.floor_lamp, fx.LAMPSHADE)),
        Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 1.1)),
    ])  # fmt: skip
    c = furnish_wall(b, room, outer[1], [
        Item(0.9, 0.3, 2.0, lambda q: fu.bookshelf(q, 0.9, 2.0, wood)),
        Item(1.6, 0.45, 1.2, lambda q: hh.television(q, 1.6, wood)),
    ])  # fmt: skip
    hang_pictures(b, room, outer[0], a, ["landscape#0", "abstract#0"])
    hang_pictures(b, room, outer[1], c, ["portrait#0"])
    x, y = room.x0 + room.width * 0.5, room.y0 + room.breadth * 0.5
    with b.at(x, y, 0, r.uniform(-0.15, 0.15)):
        small.rug(b, 2.3, 1.6, pick(r, "rug-red", "rug-sand", "rug-blue"))
        hh.coffee_table(b, 0.95, 0.55, wood)


def _kitchen(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    r = b.rng
    front = Material(pick(r, "smooth:196,206,200", "smooth:228,226,220", "ash", "smooth:92,112,124"), 1.2)
    n = round(min(2.4, room.length(outer[0]) - 1.0), 1)
    top = Material(pick(r, "stone:120,116,110", "oak", "stone:60,60,62"), 1.0)
    furnish_wall(b, room, outer[0], [
        Item(n, 0.65, 0.8, lambda q: hh.kitchen(q, n, front, top)),
        Item(0.65, 0.7, 1.85, hh.fridge),
    ])  # fmt: skip
    c = furnish_wall(b, room, outer[1], [Item(1.2, 0.45, 0.85, lambda q: fu.cabinet(q, 1.2, 0.85, 0.42, wood))])
    hang_pictures(b, room, outer[1], c, ["poster#20", "abstract#7"])
    with b.at(room.x0 + room.width * 0.5, room.y0 + room.breadth * 0.5, 0, r.uniform(-0.2, 0.2)):
        hh.dining(b, 1.1, 0.75, wood, Material("fabric:150,60,50", 0.8), chairs=2)


def _bedroom(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    r = b.rng
    cover = Material(pick(r, "check:90,110,150", "fabric:160,90,80", "check:120,140,110"), 0.8)
    a = furnish_wall(b, room, outer[0], [
        Item(1.55, 2.15, 0.8, lambda q: hh.bed(q, 1.4, wood, cover)),
        Item(0.5, 0.42, 0.55, lambda q: fu.cabinet(q, 0.45, 0.55, 0.4, wood, doors=1)),
    ])  # fmt: skip
    c = furnish_wall(b, room, outer[1], [
        Item(1.5, 0.62, 2.1, lambda q: hh.wardrobe(q, 1.5, 2.05, wood, mirror=True)),
        Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 0.9)),
    ])  # fmt: skip
    hang_pictures(b, room, outer[0], a, ["abstract#3", "landscape#4"])
    hang_pictures(b, room, outer[1], c, ["portrait#5"])


def _study(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    r = b.rng

    def desk(q: Builder) -> None:
        fu.desk(q, 1.35, 0.68, wood)
        with q.at(0.05, 1.2, 0, np.pi + r.uniform(-0.4, 0.4)):
            fu.office_chair(q, Material("fabric:60,60,66", 0.8))

    a = furnish_wall(b, room, outer[0], [
        Item(1.45, 1.3, 0.8, desk),
        Item(0.8, 0.3, 1.9, lambda q: fu.bookshelf(q, 0.8, 1.9, wood)),
    ])  # fmt: skip
    c = furnish_wall(b, room, outer[1], [
        Item(0.8, 0.3, 1.9, lambda q: fu.bookshelf(q, 0.8, 1.9, wood, fill=0.6)),
        Item(0.9, 0.9, 1.0, lambda q: hh.armchair(q, Material("fabric:150,120,70", 0.8))),
    ])  # fmt: skip
    hang_pictures(b, room, outer[0], a, ["poster#11", "landscape#9"])
    hang_pictures(b, room, outer[1], c, ["abstract#12"])
    with b.at(room.x0 + room.width * 0.5, room.y0 + room.breadth * 0.5):
        small.rug(b, 1.7, 1.2, "rug-grey")


def _flat(rng: np.random.Generator, low: float, high: float) -> Plan:
    """Four rooms, between ``low`` and ``high`` metres wide, round a crossing of walls at (X, Y)."""
    b = Builder(rng, node_spacing=0.1)
    xs, ys = rng.uniform(low, high, 2), rng.uniform(low, high, 2)
    h = 2.6
    gap = WALL / 2
    X, Y = xs[0], ys[0]
    # Doorways: y of those in the wall between west and east, x of those in the wall between south and north.
    south, north = Y * rng.uniform(0.42, 0.52), Y + ys[1] * rng.uniform(0.48, 0.58)
    west, east = X * rng.uniform(0.42, 0.52), X + xs[1] * rng.uniform(0.48, 0.58)
    spans = {
        "sw": (0.0, 0.0, X - gap, Y - gap),
        "se": (X + gap, 0.0, X + xs[1], Y - gap),
        "ne": (X + gap, Y + gap, X + xs[1], Y + ys[1]),
        "nw": (0.0, Y + gap, X - gap, Y + ys[1]),
    }
    outer = {"sw": ("west", "south"), "se": ("south", "east"), "ne": ("east", "north"), "nw": ("north", "west")}
    papers = [
        "damask:196,190,160", "leaves:190,200,176", "stripes:150,164,176", "brick:158,84,62",
        "plaster:206,170,130", "plaster:150,170,180", "plaster:190,196,160", "plaster:220,206,186",
    ]  # fmt: skip
    floors = [
        Material(n, s, macro=0.4)
        for n, s in (
            ("oak-floor", 3.0),
            ("tiles:204,196,182", 2.4),
            ("carpet:128,112,104", 2.0),
            ("walnut-parquet", 1.6),
        )
    ]
    makers = [_living, _kitchen, _bedroom, _study]
    order = rng.permutation(4)
    paper_order = rng.permutation(len(papers))
    wood_names = rng.permutation(["oak", "walnut", "cherry", "pine"])
    for k, name in enumerate(("sw", "se", "ne", "nw")):
        x0, y0, x1, y1 = spans[name]
        plain = Material(pick(rng, "plaster:226,218,200", "plaster:214,216,210", "plaster:224,212,202"), 2.5, macro=0.3)
        walls = dict.fromkeys(SIDES, plain)
        walls[outer[name][0]] = Material(papers[paper_order[k]], 1.5, macro=0.2)
        room = Room(
            x0, y0, x1, y1, h, walls, floors[order[k]], Material("smooth:238,236,230", 2.5, macro=0.1),
            Material("pine", 1.0), sky=2.6, own_view=False,
        )  # fmt: skip
        holes: dict[str, list[Opening]] = {}

        def doorway(room: Room, side: str, at: float, kind: str, holes: dict[str, list[Opening]] = holes) -> None:
            along = {"south": at - room.x0, "east": at - room.y0, "north": room.x1 - at, "west": room.y1 - at}[side]
            holes.setdefault(side, []).append(Opening(kind, along - DOORWAY / 2, along + DOORWAY / 2, 0.0, 2.1, WALL))

        if name == "sw":
            doorway(room, "east", south, "doorway")
            doorway(room, "north", west, "doorway")
        elif name == "se":
            doorway(room, "west", south, "passage")
            doorway(room, "north", east, "doorway")
        elif name == "ne":
            doorway(room, "south", east, "passage")
            doorway(room, "west", north, "doorway")
        else:
            doorway(room, "east", north, "passage")
            doorway(room, "south", west, "passage")
        side = outer[name][1]
        mid = room.length(side) * rng.uniform(0.4, 0.6)
        holes.setdefault(side, []).append(Opening("window", mid - 0.75, mid + 0.75, 0.9, 2.2))
        room.openings = holes
        build_shell(b, room)
        with room.frame(b, side):
            fx.curtains(
                b,
                holes[side][-1],
                Material(pick(rng, "fabric:176,166,146", "fabric:120,136,150", "fabric:150,96,84"), 0.8),
            )
            fx.radiator(b, mid, 1.1)
        makers[order[k]](b, room, outer[name], Material(str(wood_names[k]), 1.0))
        for side in SIDES:
            if side not in outer[name]:
                kinds = rng.permutation(["landscape", "abstract", "portrait", "poster"])[:2]
                hang_pictures(b, room, side, [], [f"{kind}#{k}{SIDES.index(side)}" for kind in kinds])
        cx, cy = (x0 + x1) / 2 + rng.uniform(-0.2, 0.2), (y0 + y1) / 2 + rng.uniform(-0.2, 0.2)
        if k % 2:
            fx.ceiling_panel(b, cx, cy, h, 0.9, 0.45, 9.0)
        else:
            fx.pendant(b, cx, cy, h, 0.42, 0.26, 16.0, Material("fabric:206,190,160", 0.8))
    for side, length in (("south", X + xs[1]), ("east", Y + ys[1]), ("north", X + xs[1]), ("west", Y + ys[1])):
        whole = Room(0, 0, X + xs[1], Y + ys[1], h, {}, floors[0], floors[0], floors[0])
        with whole.frame(b, side):
            fx.backdrop(b, length / 2, 30.0, 2.6, "outdoors")
    b.sun = (unit(0.5, -1.0, 0.9), np.array([1.5, 1.35, 1.15]))
    z = 1.45
    g = 0.55
    walk = np.array([
        [X - g, south, z], [X + g, south, z], [east, Y - g, z], [east, Y + g, z],
        [X + g, north, z], [X - g, north, z], [west, Y + g, z], [west, Y - g, z],
    ])  # fmt: skip
    return Plan(b.build(), walk)


def large(rng: np.random.Generator) -> Plan:
    """Four large rooms."""
    return _flat(rng, 4.6, 5.4)


def loop(rng: np.random.Generator) -> Plan:
    """Four rooms of medium size, for a camera that goes round more than once."""
    return _flat(rng, 3.7, 4.3)

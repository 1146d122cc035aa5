"""Plans of flats: 2 x 2 rooms joined in a ring by open doorways, and a walk round through all of them."""

from __future__ import annotations

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import interiors
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material
from panobench.rooms.plans import Plan, pick, unit
from panobench.rooms.shell import SIDES, Room, build_shell, hang_pictures

WALL = 0.16  # thickness between rooms, metres
DOORWAY = 1.05  # width, metres


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
    makers = [interiors.living, interiors.kitchen, interiors.bedroom, interiors.study]
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

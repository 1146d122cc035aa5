"""Plans of single rooms that are each hard in one way: much texture, hardly any, clutter and gloss."""

from __future__ import annotations

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import furniture as fu
from panobench.rooms import household as hh
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material
from panobench.rooms.plans import Plan, oval, pick, place, unit
from panobench.rooms.shell import SIDES, Item, Room, build_shell, furnish_wall, hang_pictures


def textured(rng: np.random.Generator) -> Plan:
    """Patterned walls, parquet, rugs, shelves and pictures everywhere."""
    b = Builder(rng)
    w, d, h = rng.uniform(4.8, 5.4), rng.uniform(4.4, 5.0), 2.7
    papers = ["brick:158,84,62", "damask:196,186,150", "leaves:184,196,170", "stripes:164,130,120", "brick:190,176,160"]
    walls = {side: Material(papers[k], 1.5, macro=0.2) for side, k in zip(SIDES, rng.permutation(5))}
    openings = {
        "west": [Opening("window", d / 2 - 0.9, d / 2 + 0.9, 0.9, 2.25)],
        "east": [Opening("door", d - 1.3, d - 0.45, 0.0, 2.05)],
    }
    floor = Material(pick(rng, "oak-parquet", "cherry-parquet", "walnut-floor"), 1.6, macro=0.35)
    wood = Material(pick(rng, "walnut", "cherry", "oak"), 1.0)
    room = Room(0, 0, w, d, h, walls, floor, Material("pine-floor", 3.0, macro=0.3), Material("oak", 1.0), openings)
    build_shell(b, room)
    with room.frame(b, "west"):
        fx.curtains(b, openings["west"][0], Material(pick(rng, "check:150,70,60", "check:70,100,120"), 0.8))
        fx.radiator(b, d / 2, 1.2)
    cover = Material(pick(rng, "check:110,120,90", "fabric:140,90,60", "check:130,80,70"), 0.8)
    pillows = [Material(f"check:{c}", 0.8) for c in ("190,150,60", "90,130,140", "170,80,80")]
    taken = {
        "south": furnish_wall(b, room, "south", [
            Item(2.1, 0.95, 0.95, lambda q: fu.sofa(q, 2.0, cover, pillows)),
            Item(0.5, 0.5, 1.7, lambda q: place(q, 0.3, small.floor_lamp, fx.LAMPSHADE)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 1.1)),
        ]),
        "north": furnish_wall(b, room, "north", [
            Item(1.0, 0.3, 2.1, lambda q: fu.bookshelf(q, 1.0, 2.1, wood, shelves=6)),
            Item(1.0, 0.3, 2.1, lambda q: fu.bookshelf(q, 1.0, 2.1, wood, shelves=6)),
            Item(1.4, 0.42, 0.85, lambda q: fu.cabinet(q, 1.4, 0.85, 0.42, wood)),
        ]),
        "east": furnish_wall(b, room, "east", [
            Item(1.3, 0.4, 1.5, lambda q: fu.bookshelf(q, 1.3, 1.5, wood, shelves=4)),
            Item(0.9, 0.9, 1.0, lambda q: hh.armchair(q, Material("check:100,110,140", 0.8))),
        ]),
        "west": furnish_wall(b, room, "west", [
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.3, small.plant, 1.0)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.3, small.plant, 0.8)),
        ]),
    }  # fmt: skip
    names = ["landscape", "abstract", "portrait", "poster"]
    for n, side in enumerate(SIDES):
        hang_pictures(b, room, side, taken[side], [f"{names[(n + k) % 4]}#{n * 4 + k}" for k in range(4)])
    with b.at(w / 2, d / 2, 0, rng.uniform(-0.1, 0.1)):
        small.rug(b, 2.6, 1.8, pick(rng, "rug-red", "rug-blue"))
        hh.coffee_table(b, 0.9, 0.55, wood)
    fx.ceiling_panel(b, w * 0.3, d * 0.5, h, 0.4, 1.0, 8.0)
    fx.ceiling_panel(b, w * 0.7, d * 0.5, h, 0.4, 1.0, 8.0)
    b.sun = (unit(-1.0, rng.uniform(-0.3, 0.3), 0.7), np.array([1.4, 1.3, 1.1]))
    return Plan(b.build(), oval(w / 2, d / 2, w / 2 - 1.5, d / 2 - 1.45, 1.5))


def bare(rng: np.random.Generator) -> Plan:
    """White walls, a plain floor, a few plain objects: there is only light and edges to track."""
    b = Builder(rng)
    w, d, h = rng.uniform(4.6, 5.2), rng.uniform(4.2, 4.8), 2.6
    white = Material(pick(rng, "smooth:230,228,222", "smooth:224,228,228", "smooth:230,224,214"), 2.5, macro=0.06)
    openings = {
        "east": [Opening("window", d * 0.5 - 0.8, d * 0.5 + 0.8, 0.95, 2.15)],
        "north": [Opening("door", 0.6, 1.45, 0.0, 2.05)],
    }
    floor = Material(pick(rng, "smooth:176,172,164", "smooth:168,160,150"), 2.5, macro=0.15)
    plain = Material("smooth:214,212,206", 1.0)
    room = Room(0, 0, w, d, h, dict.fromkeys(SIDES, white), floor, Material("smooth:238,238,236", 2.5), plain, openings)
    build_shell(b, room)
    with room.frame(b, "east"):
        fx.radiator(b, d / 2, 1.1)
    grey = Material(pick(rng, "smooth:150,154,158", "smooth:170,160,150"), 1.5)
    furnish_wall(b, room, "west", [
        Item(1.7, 0.95, 0.9, lambda q: fu.sofa(q, 1.7, grey, [plain])),
        Item(0.5, 0.5, 1.7, lambda q: place(q, 0.3, small.floor_lamp, fx.LAMPSHADE)),
    ])  # fmt: skip
    furnish_wall(
        b, room, "south", [Item(1.3, 0.42, 0.75, lambda q: fu.cabinet(q, 1.3, 0.75, 0.42, plain, things=False))]
    )
    furnish_wall(b, room, "north", [Item(1.2, 0.6, 2.1, lambda q: hh.wardrobe(q, 1.2, 2.0, plain))])
    with room.frame(b, "south"):
        fx.picture(b, w * 0.3, 1.55, 0.5, 0.7, "smooth:190,186,178", fx.BLACK)
        fx.socket(b, w * 0.75)
    with room.frame(b, "west"):
        fx.socket(b, d * 0.2)
    with b.at(w * 0.55, d * 0.72):
        fu.chair(b, Material("smooth:120,110,100", 0.6), grey)
    fx.pendant(b, w * 0.5, d * 0.5, h, 0.4, 0.28, 20.0, plain)
    b.sun = (unit(1.0, rng.uniform(-0.4, 0.4), 0.8), np.array([1.3, 1.2, 1.05]))
    return Plan(b.build(), oval(w / 2, d / 2, w / 2 - 1.4, d / 2 - 1.35, 1.45))


def cluttered(rng: np.random.Generator) -> Plan:
    """Objects everywhere, cables, plants, glossy tiles and glazed pictures."""
    b = Builder(rng)
    w, d, h = rng.uniform(5.2, 5.8), rng.uniform(4.8, 5.4), 2.7
    paint = Material(pick(rng, "plaster:212,196,170", "plaster:176,190,186", "plaster:206,184,172"), 2.5, macro=0.3)
    walls = dict.fromkeys(SIDES, paint)
    walls["north"] = Material(pick(rng, "brick:158,84,62", "stripes:150,164,176", "damask:190,180,150"), 1.5)
    openings = {
        "south": [Opening("window", w / 2 - 1.0, w / 2 + 1.0, 0.85, 2.25)],
        "east": [Opening("door", 0.5, 1.35, 0.0, 2.05)],
    }
    floor = Material(pick(rng, "tiles:150,140,126", "tiles:110,112,116", "walnut-floor"), 2.4, gloss=0.055)
    wood = Material(pick(rng, "walnut", "oak", "pine"), 1.0)
    room = Room(0, 0, w, d, h, walls, floor, Material("smooth:236,234,228", 2.5, macro=0.1), wood, openings)
    build_shell(b, room)
    with room.frame(b, "south"):
        fx.curtains(b, openings["south"][0], Material(pick(rng, "fabric:150,96,84", "fabric:110,130,120"), 0.8))
        fx.radiator(b, w / 2, 1.4)
    cover = Material(pick(rng, "fabric:110,60,60", "fabric:70,86,110"), 0.8)
    coats = [Material(c, 0.8) for c in ("fabric:60,70,96", "fabric:120,60,50", "fabric:70,76,66")]

    def desk(q: Builder) -> None:
        fu.desk(q, 1.4, 0.7, wood)
        with q.at(0.1, 1.2, 0, np.pi + rng.uniform(-0.5, 0.5)):
            fu.office_chair(q, Material("fabric:52,58,70", 0.8))

    taken = {
        "north": furnish_wall(b, room, "north", [
            Item(1.5, 1.3, 0.8, desk),
            Item(0.9, 0.3, 2.0, lambda q: fu.bookshelf(q, 0.9, 2.0, wood)),
            Item(0.9, 0.3, 1.5, lambda q: fu.bookshelf(q, 0.9, 1.5, wood, shelves=4, fill=0.5)),
            Item(0.95, 0.55, 1.1, lambda q: hh.boxes(q, 5)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 1.1)),
        ]),
        "west": furnish_wall(b, room, "west", [
            Item(1.9, 0.95, 0.95, lambda q: fu.sofa(q, 1.8, cover, [coats[1], coats[2]])),
            Item(1.5, 0.45, 1.2, lambda q: hh.television(q, 1.5, wood)),
            Item(0.5, 0.5, 1.7, lambda q: place(q, 0.3, small.floor_lamp, fx.LAMPSHADE)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.28, small.plant, 0.9)),
        ]),
        "east": furnish_wall(b, room, "east", [
            Item(1.2, 0.45, 0.85, lambda q: fu.cabinet(q, 1.2, 0.85, 0.42, wood)),
            Item(1.1, 0.3, 1.9, lambda q: hh.coat_rack(q, 0.0, coats)),
            Item(0.95, 0.55, 1.1, lambda q: hh.boxes(q, 4)),
        ]),
        "south": furnish_wall(b, room, "south", [
            Item(0.9, 0.55, 1.1, lambda q: hh.boxes(q, 3)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.3, small.plant, 1.2)),
            Item(0.5, 0.5, 1.0, lambda q: place(q, 0.3, small.plant, 0.7)),
        ]),
    }  # fmt: skip
    for n, side in enumerate(SIDES):
        names = [f"{('abstract', 'landscape', 'poster', 'portrait')[(n + k) % 4]}#{n * 3 + k}" for k in range(3)]
        hang_pictures(b, room, side, taken[side], names, gloss=0.045)
    with b.at(w * 0.52, d * 0.5, 0, rng.uniform(-0.3, 0.3)):
        hh.dining(b, 1.5, 0.85, wood, Material("fabric:120,60,50", 0.8))
    with b.at(w * 0.25, d * 0.45, 0, rng.uniform(-0.4, 0.4)):
        small.rug(b, 1.5, 1.0, pick(rng, "rug-sand", "rug-grey", "rug-blue"))
    for _ in range(3):
        hh.floor_cable(b, rng.uniform([0.8, 0.8], [w - 0.8, d - 0.8], (4, 2)))
    for k in range(9):
        x, y = rng.uniform(0.9, w - 0.9), rng.uniform(0.9, d - 0.9)
        if k % 3:
            small.knick_knack(b, x, y, 0.0)
        else:
            with b.at(x, y, 0.0, rng.uniform(0, 6)):
                b.quad((-0.1, -0.14, 0.004), (0.21, 0, 0), (0, 0.297, 0), Material(f"poster#{k}", 0.0))
    # A sagging string of bulbs and its cable under the ceiling.
    s = np.linspace(0, 1, 33)
    line = np.stack(
        [0.4 + (w - 0.8) * s, 0.5 + (d - 1.0) * s, h - 0.15 - 0.28 * np.abs(np.sin(3 * np.pi * s))], axis=-1
    )
    b.tube(line, 0.005, fx.CABLE, sides=5)
    for p in line[2:-2:3]:
        b.blob(
            p - [0, 0, 0.04], (0.022, 0.022, 0.032), Material("", emission=(4.0, 3.0, 1.8)), square=1.0, rows=6, sides=8
        )
    fx.pendant(b, w * 0.52, d * 0.5, h, 0.45, 0.24, 14.0, Material("metal:60,70,66", 0.5))
    fx.ceiling_panel(b, w * 0.2, d * 0.7, h, 0.9, 0.3, 8.0)
    b.sun = (unit(rng.uniform(-0.4, 0.4), -1.0, 0.8), np.array([1.6, 1.45, 1.2]))
    return Plan(b.build(), oval(w * 0.5, d * 0.5, w * 0.5 - 1.35, d * 0.5 - 1.3, 1.5))

"""What furnishes a room of a flat or a building. ``outer``: the two sides without openings to other rooms."""

from __future__ import annotations

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import furniture as fu
from panobench.rooms import household as hh
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.mesh import Material
from panobench.rooms.plans import pick, place
from panobench.rooms.shell import Item, Room, furnish_wall, hang_pictures


def living(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    """Sofa, shelf, television, rug."""
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


def kitchen(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    """Units, fridge, dining table."""
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


def bedroom(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    """Bed, wardrobe with a mirror."""
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


def study(b: Builder, room: Room, outer: tuple[str, str], wood: Material) -> None:
    """Desk, shelves, armchair."""
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

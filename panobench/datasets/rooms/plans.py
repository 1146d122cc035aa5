"""The built-in rooms: what stands where. A plan takes a random generator and gives a mesh and a walk through it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from panobench.datasets.rooms import fixtures as fx
from panobench.datasets.rooms import furniture as fu
from panobench.datasets.rooms.fixtures import Opening
from panobench.datasets.rooms.mesh import Builder, Material, Mesh
from panobench.datasets.rooms.shell import (
    Item,
    Room,
    build_shell,
    furnish_wall,
    hang_pictures,
)

LAMPSHADE = Material("fabric:224,206,170", 0.8)


@dataclass
class Plan:
    """A built scene and the way through it: corner points (x, y, z) of a closed walk, metres."""

    mesh: Mesh
    walk: np.ndarray


def _pick(rng: np.random.Generator, *choices: str) -> str:
    return choices[int(rng.integers(len(choices)))]


def office(rng: np.random.Generator) -> Plan:
    """A small office: desk, shelves, sofa, one window."""
    b = Builder(rng)
    w, d, h = rng.uniform(4.4, 5.0), rng.uniform(3.8, 4.3), 2.6
    paint = Material(
        _pick(rng, "plaster:226,214,190", "plaster:204,212,208", "plaster:222,206,196"),
        2.5,
        macro=0.3,
    )
    accent = Material(
        _pick(
            rng,
            "brick:158,84,62",
            "damask:196,190,160",
            "leaves:190,200,176",
            "stripes:150,164,176",
        ),
        1.5,
    )
    wood = Material(_pick(rng, "oak", "walnut", "cherry"), 1.0)
    sides = dict.fromkeys(("south", "east", "north", "west"), paint)
    sides["north"] = accent
    x = w * rng.uniform(0.45, 0.6)
    openings = {
        "east": [Opening("window", d / 2 - 0.85, d / 2 + 0.85, 0.85, 2.2)],
        "south": [Opening("door", w - 1.3, w - 0.42, 0.0, 2.05)],
    }
    room = Room(
        0, 0, w, d, h, sides, Material(_pick(rng, "oak-floor", "walnut-floor", "pine-floor"), 3.0, macro=0.4),
        Material("smooth:236,234,228", 2.5, macro=0.12), Material(_pick(rng, "oak", "pine"), 1.0), openings,
    )  # fmt: skip
    build_shell(b, room)
    with room.frame(b, "east"):
        fx.curtains(
            b,
            openings["east"][0],
            Material(_pick(rng, "fabric:170,160,140", "fabric:120,136,150"), 0.8),
        )
        fx.radiator(b, d / 2, 1.2)
    desk_w = rng.uniform(1.3, 1.5)

    def desk_set(bb: Builder) -> None:
        fu.desk(bb, desk_w, 0.7, wood)
        with bb.at(rng.uniform(-0.15, 0.1), 1.25, 0, np.pi + rng.uniform(-0.4, 0.4)):
            fu.office_chair(bb, Material("fabric:52,58,70", 0.8))

    cover = _pick(
        rng,
        "fabric:62,84,112",
        "fabric:120,70,58",
        "fabric:88,104,84",
        "fabric:150,140,128",
    )
    pillows = [
        Material(
            _pick(rng, "fabric:196,150,60", "fabric:120,170,160", "check:170,90,90"),
            0.8,
        )
        for _ in range(3)
    ]
    north = furnish_wall(b, room, "north", [
        Item(0.85, 0.3, 2.0, lambda bb: fu.bookshelf(bb, 0.85, 2.0, wood)),
        Item(0.85, 0.3, 2.0, lambda bb: fu.bookshelf(bb, 0.85, 2.0, wood)),
        Item(1.3, 0.4, 0.8, lambda bb: fu.cabinet(bb, 1.3, 0.8, 0.4, Material("ash", 1.0))),
    ])  # fmt: skip
    west = furnish_wall(b, room, "west", [
        Item(1.9, 0.95, 0.9, lambda bb: fu.sofa(bb, 1.9, Material(cover, 0.8), pillows)),
        Item(0.5, 0.5, 1.7, lambda bb: _shift(bb, 0.3, lambda q: fu.floor_lamp(q, LAMPSHADE))),
        Item(0.5, 0.5, 1.0, lambda bb: _shift(bb, 0.28, lambda q: fu.plant(q, 1.1))),
    ])  # fmt: skip
    south = furnish_wall(b, room, "south", [Item(desk_w + 0.1, 1.4, 1.25, desk_set)])
    hang_pictures(b, room, "west", west, ["landscape#0", "abstract#0"])
    hang_pictures(b, room, "north", north, ["portrait#0"])
    hang_pictures(b, room, "south", south, ["poster#9", "landscape#1"])
    with b.at(w * 0.48, d * 0.5, 0, rng.uniform(-0.1, 0.1)):
        fu.rug(b, 2.3, 1.55, _pick(rng, "rug-red", "rug-blue", "rug-sand"))
    with room.frame(b, "east"), b.at(0.4, 0.35):
        fu.plant(b, 0.9)
    fx.ceiling_panel(b, w * 0.5, d * 0.5, h, 1.2, 0.5, 11.0)
    b.sun = (_unit(1.0, rng.uniform(-0.3, 0.3), 0.75), np.array([1.7, 1.55, 1.3]))
    return Plan(
        b.build(),
        _oval(w * 0.48, d * 0.5, w * 0.5 - 1.55, d * 0.5 - 1.25, x * 0 + 1.45),
    )


def tiny(rng: np.random.Generator) -> Plan:
    """A small bare room for quick tests: few primitives, strong texture."""
    b = Builder(rng, node_spacing=0.2)
    w, d, h = 3.4, 3.0, 2.4
    sides = {
        "south": Material("plaster:222,206,184", 2.5, macro=0.4),
        "east": Material("leaves:196,200,180", 1.2),
        "north": Material("brick:158,84,62", 1.5),
        "west": Material("stripes:150,164,176", 1.2),
    }
    openings = {
        "east": [Opening("window", 0.9, 2.1, 0.9, 2.0)],
        "south": [Opening("door", 2.3, 3.1, 0.0, 2.0)],
    }
    room = Room(
        0,
        0,
        w,
        d,
        h,
        sides,
        Material("oak-floor", 3.0, macro=0.4),
        Material("plaster:236,232,222", 2.5),
        Material("pine", 1.0),
        openings,
    )
    build_shell(b, room)
    west = furnish_wall(
        b,
        room,
        "west",
        [
            Item(
                1.2,
                0.4,
                0.8,
                lambda bb: fu.cabinet(bb, 1.2, 0.8, 0.4, Material("walnut", 1.0)),
            )
        ],
    )
    hang_pictures(b, room, "west", west, ["landscape#0", "abstract#0"])
    hang_pictures(b, room, "north", [], ["portrait#0", "poster#0"])
    with b.at(w / 2, d / 2):
        fu.rug(b, 1.8, 1.2, "rug-red")
    with b.at(w / 2 - 0.2, d - 0.75):
        fu.table(b, 0.9, 0.6, 0.72, Material("oak", 1.0))
        fu.knick_knack(b, 0.1, 0.3, 0.72)
    fx.ceiling_panel(b, w * 0.5, d * 0.5, h, 0.9, 0.4, 11.0)
    return Plan(b.build(), _oval(w / 2, d / 2 - 0.1, 0.55, 0.45, 1.35))


def _shift(b: Builder, y: float, make: Callable[[Builder], None]) -> None:
    with b.at(0, y):
        make(b)


def _unit(*v: float) -> np.ndarray:
    a = np.array(v)
    return a / np.linalg.norm(a)


def _oval(x: float, y: float, a: float, c: float, z: float, n: int = 12) -> np.ndarray:
    t = 2 * np.pi * np.arange(n) / n
    return np.stack([x + a * np.cos(t), y + c * np.sin(t), z + 0.08 * np.sin(2 * t)], axis=-1)

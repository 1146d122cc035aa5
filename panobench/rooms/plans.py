"""Plans: a function from a random generator to a mesh and a walk through it. The office and the small test room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from panobench.rooms import fixtures as fx
from panobench.rooms import furniture as fu
from panobench.rooms import household as hh
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.cells import Cells
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material, Mesh
from panobench.rooms.shell import SIDES, Item, Room, build_shell, furnish_wall, hang_pictures


@dataclass
class Plan:
    """A built scene, and the corner points (N, 3) of a closed walk through it, metres. cells: of a building."""

    mesh: Mesh
    walk: np.ndarray
    cells: Cells | None = None


def pick(rng: np.random.Generator, *choices: str) -> str:
    """One of the choices at random."""
    return choices[int(rng.integers(len(choices)))]


def place(b: Builder, y: float, make: Callable[..., None], *args: Any) -> None:
    """Call ``make`` in a frame ``y`` metres away from the wall."""
    with b.at(0, y):
        make(b, *args)


def unit(*v: float) -> np.ndarray:
    """The unit vector along v."""
    a = np.array(v)
    return a / np.linalg.norm(a)


def oval(x: float, y: float, a: float, c: float, z: float, n: int = 12) -> np.ndarray:
    """A closed walk (n, 3): an ellipse with half axes a, c at about height z."""
    t = 2 * np.pi * np.arange(n) / n
    return np.stack([x + a * np.cos(t), y + c * np.sin(t), z + 0.08 * np.sin(2 * t)], axis=-1)


def office(rng: np.random.Generator) -> Plan:
    """A small office: desk, shelves, sofa, one window."""
    b = Builder(rng)
    w, d, h = rng.uniform(4.4, 5.0), rng.uniform(3.8, 4.3), 2.6
    paint = Material(pick(rng, "plaster:226,214,190", "plaster:204,212,208", "plaster:222,206,196"), 2.5, macro=0.3)
    accent = Material(
        pick(rng, "brick:158,84,62", "damask:196,190,160", "leaves:190,200,176", "stripes:150,164,176"), 1.5
    )
    wood = Material(pick(rng, "oak", "walnut", "cherry"), 1.0)
    sides = dict.fromkeys(SIDES, paint)
    sides["north"] = accent
    openings = {
        "east": [Opening("window", d / 2 - 0.85, d / 2 + 0.85, 0.85, 2.2)],
        "south": [Opening("door", w - 1.3, w - 0.42, 0.0, 2.05)],
    }
    floor = Material(pick(rng, "oak-floor", "walnut-floor", "pine-floor"), 3.0, macro=0.4)
    ceiling = Material("smooth:236,234,228", 2.5, macro=0.12)
    room = Room(0, 0, w, d, h, sides, floor, ceiling, Material(pick(rng, "oak", "pine"), 1.0), openings)
    build_shell(b, room)
    with room.frame(b, "east"):
        fx.curtains(b, openings["east"][0], Material(pick(rng, "fabric:170,160,140", "fabric:120,136,150"), 0.8))
        fx.radiator(b, d / 2, 1.2)
    desk_w = rng.uniform(1.3, 1.5)

    def desk_set(bb: Builder) -> None:
        fu.desk(bb, desk_w, 0.7, wood)
        with bb.at(rng.uniform(-0.15, 0.1), 1.25, 0, np.pi + rng.uniform(-0.4, 0.4)):
            fu.office_chair(bb, Material("fabric:52,58,70", 0.8))

    cover = Material(pick(rng, "fabric:62,84,112", "fabric:120,70,58", "fabric:88,104,84", "fabric:150,140,128"), 0.8)
    pillows = [Material(pick(rng, "fabric:196,150,60", "fabric:120,170,160", "check:170,90,90"), 0.8) for _ in range(3)]
    north = furnish_wall(b, room, "north", [
        Item(0.85, 0.3, 2.0, lambda bb: fu.bookshelf(bb, 0.85, 2.0, wood)),
        Item(0.85, 0.3, 2.0, lambda bb: fu.bookshelf(bb, 0.85, 2.0, wood)),
        Item(1.3, 0.4, 0.8, lambda bb: fu.cabinet(bb, 1.3, 0.8, 0.4, Material("ash", 1.0))),
    ])  # fmt: skip
    west = furnish_wall(b, room, "west", [
        Item(1.9, 0.95, 0.9, lambda bb: fu.sofa(bb, 1.9, cover, pillows)),
        Item(0.5, 0.5, 1.7, lambda bb: place(bb, 0.3, small.floor_lamp, fx.LAMPSHADE)),
        Item(0.5, 0.5, 1.0, lambda bb: place(bb, 0.28, small.plant, 1.1)),
    ])  # fmt: skip
    south = furnish_wall(b, room, "south", [Item(desk_w + 0.1, 1.4, 1.25, desk_set)])
    hang_pictures(b, room, "west", west, ["landscape#0", "abstract#0"])
    hang_pictures(b, room, "north", north, ["portrait#0"])
    hang_pictures(b, room, "south", south, ["poster#9", "landscape#1"])
    with room.frame(b, "south"):
        hh.clock(b, w - 0.25, 2.0)
    with b.at(w * 0.48, d * 0.5, 0, rng.uniform(-0.1, 0.1)):
        small.rug(b, 2.3, 1.55, pick(rng, "rug-red", "rug-blue", "rug-sand"))
    with room.frame(b, "east"), b.at(0.4, 0.35):
        small.plant(b, 0.9)
    fx.ceiling_panel(b, w * 0.5, d * 0.5, h, 1.2, 0.5, 11.0)
    b.sun = (unit(1.0, rng.uniform(-0.3, 0.3), 0.75), np.array([1.7, 1.55, 1.3]))
    return Plan(b.build(), oval(w * 0.48, d * 0.5, w * 0.5 - 1.55, d * 0.5 - 1.25, 1.45))


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
    openings = {"east": [Opening("window", 0.9, 2.1, 0.9, 2.0)], "south": [Opening("door", 2.3, 3.1, 0.0, 2.0)]}
    floor, ceiling = Material("oak-floor", 3.0, macro=0.4), Material("plaster:236,232,222", 2.5)
    room = Room(0, 0, w, d, h, sides, floor, ceiling, Material("pine", 1.0), openings)
    build_shell(b, room)
    wood = Material("walnut", 1.0)
    west = furnish_wall(b, room, "west", [Item(1.2, 0.4, 0.8, lambda bb: fu.cabinet(bb, 1.2, 0.8, 0.4, wood))])
    hang_pictures(b, room, "west", west, ["landscape#0", "abstract#0"])
    hang_pictures(b, room, "north", [], ["portrait#0", "poster#0"])
    with b.at(w / 2, d / 2):
        small.rug(b, 1.8, 1.2, "rug-red")
    with b.at(w / 2 - 0.2, d - 0.75):
        fu.table(b, 0.9, 0.6, 0.72, Material("oak", 1.0))
        small.knick_knack(b, 0.1, 0.3, 0.72)
    fx.ceiling_panel(b, w * 0.5, d * 0.5, h, 0.9, 0.4, 11.0)
    return Plan(b.build(), oval(w / 2, d / 2 - 0.1, 0.55, 0.45, 1.35))

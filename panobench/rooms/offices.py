"""An office building: three storeys round a court, a hall, a stairwell, and the walk of a visitor through all of it.

The corridors of the upper storeys look alike, with closed doors at equal distances; two on the ground are plain white.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.rooms import building_parts as parts
from panobench.rooms import household as hh
from panobench.rooms import interiors
from panobench.rooms.builder import Builder
from panobench.rooms.building import WALL, Building, Furnish, Space
from panobench.rooms.fixtures import Opening
from panobench.rooms.mesh import Material
from panobench.rooms.plans import Plan, pick, unit
from panobench.rooms.shell import SIDES, Room, hang_pictures

Array = NDArray[np.float64]

STOREY = parts.STOREY
CEILING = 2.75  # of rooms and corridors, metres
EYE = 1.55  # height of the camera above the floor, metres
#: Middles of the three rooms along the southern and the northern corridor, and of the two in the east.
ALONG, EAST = (8.48, 14.0, 19.52), (10.09, 14.91)
#: Corridors' middles: x of those in the west and east, y of those in the south and north; the stairs' doors.
WEST_X, EAST_X, SOUTH_Y, NORTH_Y, STAIRS_Y = 6.9, 21.1, 6.5, 18.5, 9.0

#: Middles of the rooms along the southern and the northern corridor.
ROOM_Y = {"south": 2.6, "north": 22.4}

_WHITE = Material("smooth:236,234,230", 2.5, macro=0.06)


def office_building(rng: np.random.Generator) -> Plan:
    """Built, with its cells, and the polyline of the walk."""
    b = Builder(rng, node_spacing=0.16)
    building = Building(b)
    _add_ground(building)
    for storey in (1, 2):
        _add_storey(building, rng, storey)
    _add_shared(building)
    _link_ground(building)
    for storey in range(3):
        _link_storey(building, storey)
    building.build()
    _add_surroundings(b)
    b.sun = (unit(0.3, -0.45, 0.85), np.array([2.2, 2.05, 1.75]))
    mesh = b.build()
    return Plan(mesh, visit(), building.cells(mesh))


def _room(x0: float, y0: float, x1: float, y1: float, wall: Material, floor: Material, height: float = CEILING) -> Room:
    ceiling = Material("smooth:238,236,230", 2.5, macro=0.1)
    sides = dict.fromkeys(SIDES, wall)
    return Room(x0, y0, x1, y1, height, sides, floor, ceiling, Material("pine", 1.0), {}, WALL, sky=2.6, own_view=False)


def _corridors(wall: Material, floor: Material) -> dict[str, Room]:
    return {
        "south": _room(5.8, 5.4, 22.2, 7.6, wall, floor),
        "north": _room(5.8, 17.4, 22.2, 19.6, wall, floor),
        "west": _room(5.8, 7.76, 8.0, 17.24, wall, floor),
        "east": _room(20.0, 7.76, 22.2, 17.24, wall, floor),
    }


def _windows(room: Room, side: str, count: int, width: float, sill: float = 0.9) -> None:
    """Windows to the outside, at equal distances."""
    length = room.length(side)
    for k in range(count):
        middle = (k + 0.5) * length / count
        room.openings.setdefault(side, []).append(
            Opening("window", middle - width / 2, middle + width / 2, sill, 2.3, 0.22)
        )


def _add_ground(building: Building) -> None:
    tiles = Material("tiles:196,190,178", 1.8, gloss=0.04)
    paint = Material("plaster:214,206,190", 2.5, macro=0.3)
    for name, room in _corridors(_WHITE, Material("smooth:170,166,160", 2.5, macro=0.1)).items():
        plain = name in ("north", "east")
        if not plain:
            room.wall, room.floor = dict.fromkeys(SIDES, paint), tiles
        building.add(f"0 {name}", Space(room, 0.0, parts.plain_corridor if plain else parts.corridor))
    hall = _room(5.8, -3.0, 22.2, 5.24, Material("plaster:206,170,130", 2.5, macro=0.3), tiles)
    hall.wall["north"] = Material("brick:158,84,62", 1.5)
    _windows(hall, "south", 4, 3.2, 0.25)
    building.add("hall", Space(hall, 0.0, parts.hall))
    canteen = _room(5.8, 19.76, 22.2, 25.5, Material("plaster:190,196,160", 2.5, macro=0.2), tiles)
    _windows(canteen, "north", 4, 2.2)
    wood = Material("oak", 1.0)

    def furnish(q: Builder, room: Room) -> None:
        west = _room(room.x0, room.y0, room.x0 + 6.0, room.y1, _WHITE, tiles)
        west.openings = {"north": room.openings["north"][-1:], "south": room.openings["south"][:1]}
        interiors.kitchen(q, west, ("west", "north"), wood)
        for x in (14.5, 18.5):
            with q.at(x, 23.6, 0, q.rng.uniform(-0.1, 0.1)):
                hh.dining(q, 1.7, 0.85, wood, Material("fabric:150,60,50", 0.8), chairs=6)
        parts.lamps(q, room, 4.0, 9.0)
        hang_pictures(q, room, "east", [], ["landscape#9", "abstract#12"])

    building.add("canteen", Space(canteen, 0.0, furnish))


def _add_storey(building: Building, rng: np.random.Generator, storey: int) -> None:
    z = storey * STOREY
    paint = Material("plaster:204,212,208", 2.5, macro=0.3)
    carpet = Material("carpet:104,112,128", 2.0)
    for name, room in _corridors(paint, carpet).items():
        building.add(f"{storey} {name}", Space(room, z, parts.corridor))
    papers = [
        "plaster:226,214,190", "damask:196,190,160", "stripes:150,164,176", "plaster:222,206,196",
        "leaves:190,200,176", "brick:190,176,160", "plaster:150,170,180", "plaster:206,170,130",
    ]  # fmt: skip
    floors = ["oak-floor", "walnut-parquet", "carpet:128,112,104", "pine-floor", "tiles:204,196,182"]
    order = rng.permutation(len(papers))
    boxes = {}
    for k, x in enumerate(ALONG):
        x0, x1 = (5.8, 11.32, 16.84)[k], (11.16, 16.68, 22.2)[k]
        boxes[f"south {k}"], boxes[f"north {k}"] = (x0, 0.0, x1, 5.24), (x0, 19.76, x1, 25.0)
        assert x0 < x < x1
    boxes["east 0"], boxes["east 1"] = (22.36, 7.76, 28.0, 12.42), (22.36, 12.58, 28.0, 17.24)
    for k, (name, box) in enumerate(boxes.items()):
        side = name.split()[0]
        floor = Material(floors[int(rng.integers(len(floors)))], 2.0, macro=0.4)
        room = _room(*box, Material("plaster:226,218,200", 2.5, macro=0.3), floor)
        room.wall[side] = Material(papers[int(order[k])], 1.5, macro=0.2)
        _windows(room, side, 2, 1.5)
        building.add(f"{storey} {name}", Space(room, z, _furnishing(rng, name)))


def _furnishing(rng: np.random.Generator, name: str) -> Furnish:
    """What a room on an upper storey is: an office, a study, a lounge or a kitchen."""
    side = name.split()[0]
    kind = pick(rng, "office", "office", "study", "living", "kitchen")
    if kind == "office":
        return parts.office
    make = {"study": interiors.study, "living": interiors.living, "kitchen": interiors.kitchen}[kind]
    wood = Material(pick(rng, "oak", "walnut", "cherry"), 1.0)
    second = {"south 0": "west", "south 2": "east", "north 0": "west", "north 2": "east"}.get(name, side)
    if name.startswith("east"):
        second = "south" if name.endswith("0") else "north"

    def furnish(b: Builder, room: Room) -> None:
        make(b, room, (side, second), wood)
        parts.lamps(b, room, 3.0, 9.0)

    return furnish


def _add_shared(building: Building) -> None:
    """What goes through all storeys."""
    paint = Material("plaster:216,214,206", 2.5, macro=0.3)
    stairs = _room(0.0, 7.76, 5.64, 13.0, paint, Material("stone:150,146,140", 1.5), 2 * STOREY + CEILING)
    stairs.wall["west"] = Material("brick:190,176,160", 1.5)
    building.add("stairs", Space(stairs, 0.0, parts.stairwell))
    facade = Material("brick:150,110,90", 1.2, macro=0.3)
    court = _room(8.16, 7.76, 19.84, 17.24, facade, Material("tiles:150,146,138", 2.2, macro=0.4), 3 * STOREY + 0.6)
    building.add("court", Space(court, 0.0, parts.court, shell=False))


def _link_ground(building: Building) -> None:
    for x in (9.0, 19.0):
        building.link("0 south", "hall", x, width=1.6, height=2.3)
    for x in (9.0, 18.0):
        building.link("0 north", "canteen", x, width=1.6, height=2.3)
    for corridor in ("0 south", "0 north"):
        building.link(corridor, "court", 14.0, width=1.6, height=2.3)
    for x in (10.3, 17.7):
        building.link("0 south", "court", x, width=1.6, sill=0.9, height=2.2, kind="window")


def _link_storey(building: Building, storey: int) -> None:
    name = f"{storey} {{}}".format
    for side, at in (("west", WEST_X), ("east", EAST_X)):
        for corridor in ("south", "north"):
            building.link(name(corridor), name(side), at, width=2.0, height=2.4)
    building.link(name("west"), "stairs", STAIRS_Y)
    if storey == 0:
        return
    for corridor in ("south", "north"):
        for k, x in enumerate(ALONG):
            building.link(name(corridor), name(f"{corridor} {k}"), x)
            for closed in (x - 1.84, x + 1.84):
                room = building.spaces[name(corridor)].room
                _closed_door(room, corridor, closed)
        for k in (0, 1):
            building.link(name(f"{corridor} {k}"), name(f"{corridor} {k + 1}"), ROOM_Y[corridor])
        for x in (9.6, 12.5, 15.5, 18.4):
            building.link(name(corridor), "court", x, width=1.5, sill=0.9, height=2.2, kind="window")
    for k, y in enumerate(EAST):
        building.link(name("east"), name(f"east {k}"), y)
    building.link(name("east 0"), name("east 1"), 25.2)
    for side in ("west", "east"):
        for y in (9.5, 12.5, 15.5):
            building.link(name(side), "court", y, width=1.5, sill=0.9, height=2.2, kind="window")


def _closed_door(room: Room, side: str, at: float) -> None:
    middle = at - room.x0 if side == "south" else room.x1 - at
    room.openings.setdefault(side, []).append(Opening("door", middle - 0.43, middle + 0.43, 0.0, 2.05))


def _add_surroundings(b: Builder) -> None:
    """The sky over the court and what the outer windows show, seen from everywhere."""
    glow = Material("outdoors", 0.0, emission=(1.1, 1.1, 1.1))
    b.quad((-20, -20, 13.0), (0, 70, 0), (68, 0, 0), glow, spacing=8.0, uv=(0.0, 3.0, 0.0, 0.0, 0.0, 0.2))
    for corner, along, repeats in (
        ((-6.0, -7.0), (40.0, 0.0), 3.0),
        ((34.0, -7.0), (0.0, 40.0), 3.0),
        ((34.0, 30.0), (-40.0, 0.0), 3.0),
        ((-6.0, 30.0), (0.0, -40.0), 3.0),
    ):
        p = np.array([corner[0] + along[0], corner[1] + along[1], -4.0])
        b.quad(p, (-along[0], -along[1], 0), (0, 0, 17.0), glow, spacing=6.0, uv=(0.0, repeats, 0.0, 1.0, 0.0, -1.0))


def visit() -> Array:
    """The polyline (N, 3) of the walk: hall, court, up the stairs, round every storey and through rooms, and back."""
    way = _Way()
    way.to(
        (14.0, 3.6), (19.0, 2.6), (19.0, SOUTH_Y), (EAST_X, SOUTH_Y), (EAST_X, NORTH_Y), (18.0, NORTH_Y), (18.0, 22.0)
    )
    way.to((9.0, 22.0), (9.0, NORTH_Y), (14.0, NORTH_Y), (14.0, 14.0), (11.0, 12.5), (14.0, 10.5), (14.0, SOUTH_Y))
    way.to((WEST_X, SOUTH_Y), (WEST_X, STAIRS_Y)).up()
    way.to((WEST_X, NORTH_Y), *_through("north"), (EAST_X, NORTH_Y), (EAST_X, EAST[1]), (25.2, EAST[1]))
    way.to((25.2, EAST[0]), (EAST_X, EAST[0]), (EAST_X, SOUTH_Y), *_through("south")[::-1], (WEST_X, SOUTH_Y))
    way.to((WEST_X, STAIRS_Y)).up()
    way.to((WEST_X, SOUTH_Y), (EAST_X, SOUTH_Y), (EAST_X, NORTH_Y), (WEST_X, NORTH_Y), (WEST_X, SOUTH_Y))
    way.to(*_through("south"), (EAST_X, SOUTH_Y), (EAST_X, EAST[0]), (25.2, EAST[0]), (25.2, EAST[1]))
    way.to((EAST_X, EAST[1]), (EAST_X, NORTH_Y), *_through("north")[::-1], (WEST_X, NORTH_Y), (WEST_X, STAIRS_Y)).down()
    way.to((WEST_X, SOUTH_Y), (EAST_X, SOUTH_Y), (EAST_X, NORTH_Y), (WEST_X, NORTH_Y), (WEST_X, STAIRS_Y)).down()
    way.to((WEST_X, SOUTH_Y), (9.0, SOUTH_Y), (9.0, 3.4), (14.0, 3.6), (19.0, 3.0), (16.0, 4.2), (14.0, 3.6))
    return np.array(way.points)


def _through(side: str) -> list[tuple[float, float]]:
    """From the corridor into the first of three rooms, through all, and out again."""
    corridor, room = SOUTH_Y if side == "south" else NORTH_Y, ROOM_Y[side]
    return [(ALONG[0], corridor), (ALONG[0], room), (ALONG[1], room), (ALONG[2], room), (ALONG[2], corridor)]


class _Way:
    """A polyline that is being drawn, at the eye's height above the floor."""

    def __init__(self) -> None:
        self.z = EYE
        self.points: list[tuple[float, float, float]] = []

    def to(self, *places: tuple[float, float]) -> _Way:
        self.points += [(x, y, self.z) for x, y in places]
        return self

    def up(self) -> None:
        """From the stairs' door up one storey."""
        self._climb(1.0)

    def down(self) -> None:
        """The same way back."""
        self._climb(-1.0)

    def _climb(self, sign: float) -> None:
        x1 = 5.64 - parts.LANDING
        x0, half = x1 - parts.REACH, 0.5 * STOREY
        lower, upper = STAIRS_Y, 13.0 - parts.FLIGHT / 2
        rise = [(4.8, lower, 0.0), (x1, lower, 0.0), (x0, lower, half), (0.7, lower, half), (0.7, upper, half)]
        rise += [(x0, upper, half), (x1, upper, STOREY), (4.8, upper, STOREY), (4.8, lower, STOREY)]
        base = self.z if sign > 0 else self.z - STOREY
        self.points += [(x, y, base + h) for x, y, h in (rise if sign > 0 else rise[::-1])]
        self.z += sign * STOREY
        self.points.append((WEST_X, lower, self.z))

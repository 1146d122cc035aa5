"""The built-in kinds of rooms: a plan and a camera motion for each name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from panobench.rooms import flats, offices, plans, singles
from panobench.rooms.motion import Motion
from panobench.rooms.plans import Plan
from panobench.rooms.walks import Walk


@dataclass(frozen=True)
class Kind:
    """summary: one line for `panobench list`. plan: builds the room. motion: how the camera moves through it.

    walk: instead of ``motion``, somebody walks the plan's polyline once, and the frames are those from ``first`` on.
    scene: kinds with the same one are cut out of the same walk through the same scene.
    """

    summary: str
    plan: Callable[[np.random.Generator], Plan]
    motion: Motion
    walk: Walk | None = None
    first: int = 0
    scene: str = ""


def _cut(summary: str, first: int, frames: int) -> Kind:
    """A part of the walk through the office building."""
    return Kind(summary, offices.office_building, Motion(frames=frames), Walk(6000), first, "building")


KINDS: dict[str, Kind] = {
    "room1": Kind("small office", plans.office, Motion()),
    "room2": Kind("large flat, four rooms joined by doorways", flats.large, Motion(frames=150, step=0.045, swing=0.7)),
    "room3": Kind(
        "texture-rich room, fast yaw (up to 6 deg/frame)",
        singles.textured,
        Motion(step=0.035, yaw_rate=0.072, swing=0.15, period=40.0),
    ),
    "room4": Kind("nearly textureless white room", singles.bare, Motion(step=0.035)),
    "room5": Kind(
        "cluttered room, glossy floor, aggressive 6-DoF motion",
        singles.cluttered,
        Motion(step=0.042, swing=0.75, tilt=0.24, bounce=0.1, period=56.0),
    ),
    "loop": Kind(
        "1000 frames, two rounds through a four-room flat",
        flats.loop,
        Motion(frames=1000, rounds=2.0, swing=0.8, yaw_rate=4 * 3.14159265 / 1000, period=83.0),
    ),
    "building": _cut("office building: 428 m over three storeys, a hall, stairs and a court", 0, 6000),
    "building-entry": _cut("its ground floor: hall, white corridors, canteen, court, the stairs", 0, 1000),
    "building-storey": _cut("its first floor: a round through eight rooms and four corridors", 1300, 1000),
    "building-twins": _cut("up the stairs to a second floor that looks like the first", 2300, 1000),
    "tiny": Kind("small bare room for tests", plans.tiny, Motion(frames=40, step=0.035)),
}

"""The built-in kinds of rooms: a plan and a camera motion for each name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from panobench.rooms import flats, plans, singles
from panobench.rooms.motion import Motion
from panobench.rooms.plans import Plan


@dataclass(frozen=True)
class Kind:
    """summary: one line for `panobench list`. plan: builds the room. motion: how the camera moves through it."""

    summary: str
    plan: Callable[[np.random.Generator], Plan]
    motion: Motion


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
    "tiny": Kind("small bare room for tests", plans.tiny, Motion(frames=40, step=0.035)),
}

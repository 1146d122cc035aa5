"""The kinds of rooms that come built in: a plan and a way of moving for each name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from panobench.datasets.rooms import plans
from panobench.datasets.rooms.motion import Motion
from panobench.datasets.rooms.plans import Plan


@dataclass(frozen=True)
class Kind:
    """summary: one line for people. plan: builds the room. motion: how the camera goes through it."""

    summary: str
    plan: Callable[[np.random.Generator], Plan]
    motion: Motion


KINDS: dict[str, Kind] = {
    "room1": Kind("small office", plans.office, Motion()),
    "tiny": Kind("small bare room for tests", plans.tiny, Motion(frames=40, step=0.035)),
}

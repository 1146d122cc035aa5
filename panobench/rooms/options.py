"""Variations of a room sequence, and the names that users type for them: ``room1@7+blur2+noise0.03``."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, replace
from typing import Any

from panobench.errors import UnknownNameError, UsageError


@dataclass(frozen=True)
class RoomOptions:
    """Variations of a room sequence; the defaults give the plain sequence.

    seed:      chooses another room of the same kind: layout, colours, textures and path. In a name: "@7".
    frames:    length of the sequence; None: the kind's own. "+frames300".
    noise:     standard deviation of the sensor noise; full scale is 1. "+noise0.03".
    blur:      motion blur, as the median length of the streaks in pixels. "+blur2".
    exposure:  size in stops of two smooth changes of the camera's gain, first down, then up. "+exposure" (0.7).
    rolling:   amplitude in stops of a gain that follows a sine over time and over the rows. "+rolling" (0.5).
    occluder:  share of the sphere that a dark object moving before the camera hides. "+occluder" (0.25).
    black:     number of black frames from the middle of the sequence on. "+black" (20).

    Raises UsageError for a value out of range.
    """

    seed: int = 0
    frames: int | None = None
    noise: float = 0.9 / 255
    blur: float = 0.0
    exposure: float = 0.0
    rolling: float = 0.0
    occluder: float = 0.0
    black: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("seed", 0, 2**31 - 1),
            ("noise", 0.0, 0.5),
            ("blur", 0.0, 32.0),
            ("exposure", -3.0, 3.0),
            ("rolling", 0.0, 3.0),
            ("occluder", 0.0, 0.9),
            ("black", 0, 100000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"room option {name}={value}: must be between {low} and {high}")
        if self.frames is not None and not 2 <= self.frames <= 100000:
            raise UsageError(f"room option frames={self.frames}: must be between 2 and 100000")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for provenance and cache keys."""
        return asdict(self)


#: The value of a variant that is named without a number.
_BARE = {
    "blur": 2.0,
    "exposure": 0.7,
    "rolling": 0.5,
    "occluder": 0.25,
    "black": 20,
    "noise": 0.03,
}
_WHOLE = {"black", "frames"}
VARIANTS = ("black", "blur", "exposure", "frames", "noise", "occluder", "rolling")


def parse_name(name: str, base: RoomOptions | None = None) -> tuple[str, RoomOptions]:
    """Split "room1@7+blur2" into "room1" and its options; what the name says takes precedence over ``base``.

    Raises UnknownNameError for an unknown variant, UsageError for a number that does not parse or is out of range.
    """
    head, *parts = name.split("+")
    kind, at, seed = head.partition("@")
    values: dict[str, Any] = {}
    if at:
        if not seed.isdigit():
            raise UsageError(f"room sequence '{name}': '@{seed}' is not a seed; write for example {kind}@7")
        values["seed"] = int(seed)
    for part in parts:
        match = re.fullmatch(r"([a-z]+)([-0-9.eE]*)", part)
        word = match.group(1) if match else part
        if word not in VARIANTS:
            raise UnknownNameError("room variant", word, VARIANTS)
        number = match.group(2) if match else ""
        if not number and word not in _BARE:
            raise UsageError(f"room sequence '{name}': '+{word}' needs a number")
        try:
            value = float(number) if number else float(_BARE[word])
        except ValueError:
            raise UsageError(f"room sequence '{name}': '+{part}' does not end in a number") from None
        if word in _WHOLE and value != int(value):
            raise UsageError(f"room sequence '{name}': '+{part}' needs a whole number")
        values[word] = int(value) if word in _WHOLE else value
    return kind, replace(base or RoomOptions(), **values)

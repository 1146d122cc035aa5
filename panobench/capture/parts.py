"""The parts of a simulated recording and how they are named: ``operator-15+walkers-3+rolling-15ms``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

from panobench.errors import UnknownNameError, UsageError


class Form(NamedTuple):
    """How a part is written: its unit, what one of it is in the field's unit, the value without a number, bounds."""

    unit: str
    factor: float
    bare: float
    low: float
    high: float


#: By field of ``Parts``; bare, low and high in the written unit.
FORMS: Mapping[str, Form] = {
    "operator": Form("", 0.01, 15, 1, 35),
    "car": Form("", 0.01, 25, 5, 45),
    "walkers": Form("", 1, 3, 1, 12),
    "rolling": Form("ms", 1e-3, 15, 0.1, 100),
    "stitch": Form("mm", 1e-3, 41, 0, 200),
    "lenses": Form("", 1, 0.3, 0, 2),
    "levelled": Form("", 1, 1, 1, 1),
    "locked": Form("", 1, 1, 1, 1),
    "gait": Form("", 0.01, 100, 1, 400),
    "tilt": Form("", 1, 15, 1, 60),
    "turn": Form("", 1, 200, 1, 720),
    "blur": Form("ms", 1e-3, 10, 0.1, 100),
    "h264": Form("", 1, 0.2, 0.005, 10),
    "h265": Form("", 1, 0.2, 0.005, 10),
    "seed": Form("", 1, 1, 0, 1e6),
}
_WHOLE = ("walkers", "seed")


@dataclass(frozen=True)
class Parts:
    """What a recording is made of; 0 leaves a part out.

    operator: share of the sphere that the person who carries the camera hides. "operator-15": per cent.
    car:      share of the sphere that the car under the camera hides. "car-25": per cent.
    walkers:  people who walk through the scene. "walkers-3".
    rolling:  seconds from the first row of a lens to its last. "rolling-15ms".
    stitch:   metres between two lenses whose pictures are stitched for things two metres away. "stitch-41mm".
    lenses:   stops by which the lenses' exposures swing; their white balance differs by a third of it. "lenses-0.3".
    levelled: the picture is turned so that its vertical stays vertical. "levelled".
    locked:   it is turned so that it looks in one direction all the time, too. "locked".
    gait:     how the camera sways with the steps, 1 for a brisk walk. "gait-100": per cent.
    tilt:     how far the camera slowly tilts and rolls, degrees. "tilt-15".
    turn:     peak rate of a swing about the vertical, degrees per second. "turn-200".
    blur:     exposure time, seconds. "blur-10ms".
    h264, h265: bits per pixel the stream is compressed to. "h264-0.1".
    seed:     other people, paths and phases. "seed-1".
    """

    operator: float = 0.0
    car: float = 0.0
    walkers: int = 0
    rolling: float = 0.0
    stitch: float = 0.0
    lenses: float = 0.0
    levelled: float = 0.0
    locked: float = 0.0
    gait: float = 0.0
    tilt: float = 0.0
    turn: float = 0.0
    blur: float = 0.0
    h264: float = 0.0
    h265: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.operator and self.car:
            raise UsageError("parts operator and car: one of them carries the camera")
        if self.h264 and self.h265:
            raise UsageError("parts h264 and h265: a stream has one codec")

    def to_dict(self) -> dict[str, Any]:
        """Those that are not 0."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name)}

    def __bool__(self) -> bool:
        return bool({k for k in self.to_dict() if k != "seed"})

    @property
    def need_a_scene(self) -> list[str]:
        """Those that need poses between frames and depth, which only a rendered scene has."""
        scene = ("walkers", "rolling", "stitch", "levelled", "locked", "gait", "tilt", "turn", "blur")
        return [name for name in scene if getattr(self, name)]


def parse_part(text: str) -> tuple[str, float] | None:
    """ "rolling-15ms" -> ("rolling", 0.015); None: no part. Raises UsageError for a number that does not fit."""
    match = re.fullmatch(r"([a-z]+(?:26[45])?)(?:-([0-9.]+(?:e-?[0-9]+)?)([a-z]*))?", text)
    if match is None or match[1] not in FORMS:
        return None
    name, number, unit = match[1], match[2], match[3] or ""
    form = FORMS[name]
    if unit not in ("", form.unit):
        right = f"its unit is '{form.unit}', not '{unit}'" if form.unit else f"it takes a number without '{unit}'"
        raise UsageError(f"part '{text}': {right}")
    try:
        value = form.bare if number is None else float(number)
    except ValueError:
        raise UsageError(f"part '{text}': '{number}' is not a number") from None
    if not form.low <= value <= form.high:
        unit = form.unit and " " + form.unit
        raise UsageError(f"part '{text}': must be between {form.low:g} and {form.high:g}{unit}")
    if name in _WHOLE and value != int(value):
        raise UsageError(f"part '{text}': needs a whole number")
    return name, value * form.factor


def split_name(name: str, others: tuple[str, ...] = ()) -> tuple[str, Parts]:
    """ "room1+blur2+operator-15" -> ("room1+blur2", Parts(operator=0.15)).

    What a sequence may have behind a "+" itself is in ``others`` (words); a bare word of theirs is theirs. Raises
    UnknownNameError for a word that looks like a part ("opperator-5") and is none.
    """
    head, *texts = name.split("+")
    kept: list[str] = [head]
    values: dict[str, Any] = {}
    for text in texts:
        part = None if text in others else parse_part(text)
        if part is not None:
            values[part[0]] = int(part[1]) if part[0] in _WHOLE else part[1]
        elif (like := re.fullmatch(r"([a-z]+)-[0-9.]+[a-z]*", text)) and like[1] not in others:
            raise UnknownNameError("part of a recording", like[1], FORMS)
        else:
            kept.append(text)
    return "+".join(kept), replace(Parts(), **values)

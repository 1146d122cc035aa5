"""Which column of a table is what, by the names people and programs give them in a header.

Known are the headers of TUM, EuRoC, rostopic, rosbag exports and the many hand-written ones in between: ``timestamp
[ns], p_RS_R_x [m], ..., q_RS_w []``, ``ts,tx,ty,tz,qx,qy,qz,qw``, ``field.pose.orientation.w``, ``pos_x``, ``gyro_z``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

#: Words that stand for a unit or say nothing about what is measured.
_FILLERS = {
    *("m", "meter", "meters", "metre", "metres", "rad", "unit", "field", "pose", "msg", "data", "header", "value"),
    *("world", "camera", "cam", "body", "imu", "gt", "groundtruth", "est", "estimated", "frame", "raw", "in", "rs"),
    *("val", "r", "s", "i", "c", "s1", "wc", "wb", "wi", "bc", "w2c", "c2w", "1", "2"),
}
_POSITION = {"p", "pos", "position", "t", "trans", "translation", "loc", "location", "xyz"}
_QUATERNION = {"q", "quat", "quaternion", "orientation", "orient", "ori", "rot", "rotation", "att", "attitude"}
_GYRO = {"w", "g", "gyr", "gyro", "gyroscope", "omega", "angular", "angvel", "rate"}
_ACCEL = {"a", "acc", "accel", "acceleration", "accelerometer"}
#: Columns with one of these words are none of the above.
_OTHER = {
    *("v", "vel", "twist", "cov", "covariance", "std", "sigma", "var", "variance", "bias", "error", "err", "mag"),
}
_TIME = {"time", "timestamp", "timestamps", "ts", "stamp", "t", "secs", "sec", "seconds", "nsecs", "nsec", "nanosec"}
_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("us", "usec", "µs", "microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds", "nanos"), 1e-9),
}
_DEGREE = math.pi / 180
#: Units of length, angular rate and acceleration that are not metres, rad/s and m/s^2.
_LENGTHS = {"mm": 1e-3, "millimeters": 1e-3, "millimetres": 1e-3, "cm": 1e-2, "centimeters": 1e-2, "centimetres": 1e-2}
_RATES = dict.fromkeys(("deg/s", "deg", "degs", "dps", "°/s", "degree/s", "degrees/s", "deg/sec"), _DEGREE)
_ACCELERATIONS = {**dict.fromkeys(("g", "gs", "gravity"), 9.80665), "mg": 9.80665e-3}
#: A unit at the end of a name, without brackets: x_mm, gyro_x_dps.
_SUFFIXES = {"mm", "cm", "dps", "deg", "mg"}


@dataclass(frozen=True)
class Columns:
    """Places of what a header names; None for what it does not.

    unit_s: seconds that a unit of the time stands for, if the name says so. nanoseconds: a second column to be added to
    the first, as ROS writes stamps. quaternion: in the order x, y, z, w, as files store it, wherever they stand.
    position_m, gyro_rad_s, accel_m_s2: what one unit of those columns is, where their names have a unit.
    """

    time: int | None = None
    unit_s: float | None = None
    nanoseconds: int | None = None
    position: tuple[int, ...] | None = None
    quaternion: tuple[int, ...] | None = None
    gyro: tuple[int, ...] | None = None
    accel: tuple[int, ...] | None = None
    position_m: float = 1.0
    gyro_rad_s: float = 1.0
    accel_m_s2: float = 1.0


def is_header(fields: Sequence[str]) -> bool:
    """Whether a row is made of names: none of its fields is a number, some have letters."""
    for text in fields:
        try:
            float(text)
        except ValueError:
            continue
        return False
    return any(any(c.isalpha() for c in text) for text in fields)


def columns(names: Sequence[str]) -> Columns:
    """What each of a header's names stands for; the first of several that mean the same counts."""
    found: dict[str, dict[str, int]] = {}
    for place, name in enumerate(names):
        kind, axis = _quantity(name)
        if kind:
            found.setdefault(kind, {}).setdefault(axis, place)
    time, unit, nanoseconds = _time(names)
    return Columns(
        time,
        unit,
        nanoseconds,
        _axes(found.get("position"), "xyz"),
        _axes(found.get("quaternion"), "xyzw"),
        _axes(found.get("gyro"), "xyz"),
        _axes(found.get("accel"), "xyz"),
        _unit(names, found.get("position"), _LENGTHS),
        _unit(names, found.get("gyro"), _RATES),
        _unit(names, found.get("accel"), _ACCELERATIONS),
    )


def _unit(names: Sequence[str], places: dict[str, int] | None, units: dict[str, float]) -> float:
    """What the unit in brackets or at the end of a column's name stands for; 1 for none, and for one unknown."""
    if not places:
        return 1.0
    name = names[next(iter(places.values()))].strip().lower()
    bracketed = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
    unit = bracketed[1] if bracketed else _words(name)[-1]
    return units.get(re.sub(r"[\s*·.^_]", "", unit), 1.0)


def _axes(places: dict[str, int] | None, axes: str) -> tuple[int, ...] | None:
    return tuple(places[a] for a in axes) if places is not None and all(a in places for a in axes) else None


def _words(name: str) -> list[str]:
    """A name's words in lower case: p_RS_R_x [m] -> p, rs, r, x, m; posX -> pos, x."""
    parted = re.sub(r"([a-z])([XYZW])\b", r"\1_\2", name.strip())
    return [word for word in re.split(r"[^a-zµ0-9]+", parted.lower()) if word]


def _quantity(name: str) -> tuple[str, str]:
    """(kind, axis) of a column, ("", "") for one that is none of ours."""
    kept = [w for w in _words(re.sub(r"\[.*?\]|\(.*?\)", "", name)) if w not in _FILLERS]
    if len(kept) > 1 and kept[-1] in _SUFFIXES:
        kept.pop()
    if not kept or set(kept) & _OTHER:
        return "", ""
    *about, last = kept
    # "tx", "qw", "accx": the axis is the last letter of a word.
    joined = last[-1] in "xyzw" and last[:-1] in _POSITION | _QUATERNION | _GYRO | _ACCEL
    axis = last[-1] if joined else last
    if axis not in ("x", "y", "z", "w"):
        return "", ""
    about = [*about, last[:-1]] if joined else about
    if not about:
        return ("quaternion", "w") if axis == "w" else ("position", axis)
    for word in (about[0], about[-1]):  # p_RS_R_x, /odom/pose/position/x
        for kind, known in (("quaternion", _QUATERNION), ("position", _POSITION), ("gyro", _GYRO), ("accel", _ACCEL)):
            if word in known:
                return kind, axis
    return "", ""


def _time(names: Sequence[str]) -> tuple[int | None, float | None, int | None]:
    """Place and unit of the time, and the place of ROS's nanoseconds; a message's own stamp before a recorder's."""
    found: list[tuple[bool, int, float | None]] = []
    for place, name in enumerate(names):
        words = [w for w in _words(name) if w not in _FILLERS - {"header"}]
        if not words or words[0] not in _TIME | {"header"} or not set(words) & _TIME:
            continue
        own = "stamp" in words and "header" in words
        unit = next((_UNITS[w] for w in words if w in _UNITS), None)
        if unit is None and (own or name.strip().startswith("%time")):
            unit = 1e-9  # rostopic echo -p
        found.append((own, place, unit))
    if not found:
        return None, None, None
    own = any(o for o, _, _ in found)
    chosen = [(place, unit) for o, place, unit in found if o == own]
    units = [unit for _, unit in chosen]
    if 1.0 in units and 1e-9 in units and len(chosen) > 1:
        return chosen[units.index(1.0)][0], 1.0, chosen[units.index(1e-9)][0]
    return (*chosen[0], None)

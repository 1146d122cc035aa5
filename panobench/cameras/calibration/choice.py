"""Which camera of a file with several: the one asked for, or the first with a word about the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from panobench.errors import CalibrationError, UnknownNameError


def choose(path: Path, wanted: str | None, names: Sequence[str], prefix: str = "") -> str:
    """``wanted`` if the file has it (also without the ``prefix`` of all names), else the first for None.

    Raises CalibrationError, with the nearest name.
    """
    if wanted is None:
        return names[0]
    for name in (wanted, prefix + wanted):
        if name in names:
            return name
    raise CalibrationError(str(UnknownNameError("camera", wanted, names)), path)


def others(name: str, names: Sequence[str]) -> list[str]:
    """A note that says which camera it is, and what else the file has."""
    rest = [n for n in names if n != name]
    return [f"camera {name}" + (f"; the file also has {', '.join(rest[:8])}" if rest else "")]


def doubts(path: Path, wanted: str | None, name: str, names: Sequence[str]) -> list[str]:
    """What a user should know who named no camera of a file with several."""
    if wanted is not None or len(names) < 2:
        return []
    listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return [f"the file has the cameras {listed}: {name} is taken; choose with {path.name}#{names[1]}"]

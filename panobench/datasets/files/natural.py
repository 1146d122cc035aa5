"""The order of file names in which people number them: frame2 before frame10."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path, PurePath

_NUMBER = re.compile(r"([0-9]+)")
_DECIMAL = re.compile(r"[0-9]+\.[0-9]+")


def natural_key(name: str) -> tuple[list[tuple[int, str | int]], str]:
    """Sorts names by their text and the value of the whole numbers in it, then as they are written.

    A number in the place of text comes first, as it does in plain order.
    """
    parts = _NUMBER.split(name)
    return [(0, int(part)) if part.isdigit() and part.isascii() else (1, part) for part in parts if part], name


def natural_names(names: Iterable[str]) -> list[str]:
    """File names in natural order; by value where each but for its ending is a decimal fraction: 0.25, 0.5."""
    found = list(names)
    if found and all(_DECIMAL.fullmatch(PurePath(name).stem) for name in found):
        return sorted(found, key=lambda name: (float(PurePath(name).stem), name))
    return sorted(found, key=natural_key)


def same_but_for_numbers(names: Iterable[str]) -> bool:
    """Whether names are numbered alike: r_2.png and r_10.png are, left.png and right.png are not."""
    return len({_NUMBER.sub("0", name) for name in names}) == 1


def natural_paths(paths: Iterable[Path]) -> list[Path]:
    """Paths in natural order of their folders, then of their names, each part by itself."""
    groups: dict[tuple[str, ...], dict[str, Path]] = {}
    for path in paths:
        groups.setdefault(path.parts[:-1], {})[path.name] = path
    folders = sorted(groups, key=lambda parts: [natural_key(part) for part in parts])
    return [groups[folder][name] for folder in folders for name in natural_names(groups[folder])]

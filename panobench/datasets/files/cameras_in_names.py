"""Images of several cameras in one folder, told apart by their names: 1_left and 1_right, cam0_1 and cam1_1."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from panobench.datasets.files.natural import natural_key

#: A numbered camera: cam0, camera_2, lens1.
_NUMBERED = re.compile(r"(?:cam|camera|lens|sensor|view)[-_]?(\d{1,2})(?!\d)", re.IGNORECASE)
_NUMBER = re.compile(r"\d+")
#: More kinds of names than this are no cameras of one rig, and fewer images of each no sequences.
_MOST, _FEWEST = 8, 3
#: Share of the numbers of each that all have.
_COMMON = 0.8


def by_camera(images: Sequence[Path]) -> dict[str, list[Path]]:
    """Camera -> its images in their order, where a folder has those of several; {} where they are of one.

    They are of several if leaving out the camera's name, or its number behind "cam", leaves the same names for each.
    """
    return _split(images, _numbered) or _split(images, _named)


def _split(images: Sequence[Path], parts: Callable[[str], tuple[str, str] | None]) -> dict[str, list[Path]]:
    groups: dict[str, list[Path]] = {}
    frames: dict[str, set[str]] = {}
    for path in images:
        found = parts(path.stem)
        if found is None:
            return {}
        camera, frame = found
        groups.setdefault(camera, []).append(path)
        frames.setdefault(camera, set()).add(frame)
        if len(groups) > _MOST:
            return {}
    if len(groups) < 2 or min(len(group) for group in groups.values()) < _FEWEST:
        return {}
    common = set.intersection(*frames.values())
    if len(common) < _COMMON * max(len(group) for group in groups.values()):
        return {}
    names = _differing(list(groups))
    return {names[camera]: groups[camera] for camera in sorted(groups, key=natural_key)}


def _numbered(stem: str) -> tuple[str, str] | None:
    """ "cam1_0007" -> ("cam1", "_0007")."""
    found = _NUMBERED.search(stem)
    if found is None:
        return None
    return found[0], stem[: found.start()] + stem[found.end() :]


def _named(stem: str) -> tuple[str, str] | None:
    """ "frame_7_left" -> ("frame_#_left", "7")."""
    numbers = _NUMBER.findall(stem)
    return (_NUMBER.sub("#", stem), "_".join(map(str, map(int, numbers)))) if numbers else None


def _differing(patterns: list[str]) -> dict[str, str]:
    """What tells each pattern from the others, as a word: "frame_#_left" -> "left"."""
    words = {pattern: [w for w in re.split(r"[^A-Za-z0-9]+", pattern) if w] for pattern in patterns}
    shared = set.intersection(*(set(w) for w in words.values()))
    labels = {p: "-".join(w for w in found if w not in shared) or "plain" for p, found in words.items()}
    return labels if len(set(labels.values())) == len(labels) else {p: p.replace("#", "N") for p in patterns}

"""Where a dataset's files are: `--root`, else ``$PANOBENCH_DATA/NAME``; and the message when they are missing."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from panobench.errors import DatasetError, UnknownNameError
from panobench.specs import DatasetSpec

DATA_VARIABLE = "PANOBENCH_DATA"


def describe(spec: DatasetSpec) -> str:
    """What the dataset is, who publishes it, and the layout that is expected, as a few lines of text."""
    lines = [f"{spec.name}: {spec.summary}"]
    if spec.publisher:
        lines.append(f"published by: {spec.publisher}")
    if spec.obtain:
        lines.append(f"to get it: {spec.obtain}")
    if spec.layout:
        lines.append(f"expected layout: {spec.layout}")
    if spec.needs_root:
        lines.append(f"looked for under: --root PATH, else ${DATA_VARIABLE}/{spec.name}")
    return "\n".join(lines)


def _one_line(spec: DatasetSpec) -> str:
    return "; ".join(describe(spec).splitlines())


def _look(place: Path | str) -> tuple[Path, bool]:
    """The path with ~ expanded, and whether it exists; an impossible name does not."""
    try:
        path = Path(place).expanduser()
        return path, path.exists()
    except (OSError, RuntimeError, ValueError):  # a name that is too long, an unknown user's home, a NUL
        return Path(place), False


def locate(spec: DatasetSpec, root: Path | str | None = None) -> Path | None:
    """The dataset's file or folder; None for a generator without one.

    Raises DatasetError, which describes the dataset, if nothing is there.
    """
    if root is not None:
        path, there = _look(root)
        if not there:
            raise DatasetError(f"no such file or folder (--root). {_one_line(spec)}", path)
        return path
    if not spec.needs_root:
        return None
    base = os.environ.get(DATA_VARIABLE)
    if not base:
        raise DatasetError(
            f"dataset '{spec.name}' needs --root PATH (or ${DATA_VARIABLE}, which is not set). {_one_line(spec)}"
        )
    path, there = _look(Path(base) / spec.name)
    if not there:
        raise DatasetError(f"dataset '{spec.name}' is not there. {_one_line(spec)}", path)
    return path


def choose_sequence(kind: str, wanted: str | None, known: Iterable[str]) -> str:
    """``wanted``, or for None the first. Raises UnknownNameError, with the nearest name, for an unknown one."""
    names = list(known)
    if wanted is None and names:
        return names[0]
    if wanted not in names:
        raise UnknownNameError(f"sequence of {kind}", str(wanted), names)
    return str(wanted)

"""Read suite files: a YAML matrix of methods, cameras, datasets and seeds is expanded into cells.

Every mistake in a file is an InputError or UnknownNameError that names the file and the entry.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panobench.bench.run.request import RunRequest
from panobench.bench.suite.cells import Cell, Limits
from panobench.bench.suite.model import LIMITS, DatasetEntry, MethodEntry, own_options, parse_suite
from panobench.errors import DatasetError, InputError, PanobenchError, UnavailableError
from panobench.plugins import registry
from panobench.reading import parse_yaml, read_text
from panobench.specs import DatasetSpec, MethodSpec

MAX_CELLS = 100_000


@dataclass(frozen=True)
class Suite:
    """A suite's name and its cells in the file's order. notes: a line for each dataset that could not be listed."""

    name: str
    cells: tuple[Cell, ...]
    notes: tuple[str, ...] = field(default=())


def read_suite(path: Path) -> Suite:
    """Parse a suite file and expand it. Raises InputError or UnknownNameError."""
    suite = parse_suite(parse_yaml(read_text(path, "the suite file"), path), path)
    if suite.repeats > MAX_CELLS:
        raise InputError(f"repeats: more than {MAX_CELLS} cells", path)
    for method in suite.methods:
        registry().get(MethodSpec, method.name)
    for dataset in suite.datasets:
        registry().get(DatasetSpec, dataset.name)
    notes: list[str] = []
    cells: dict[str, Cell] = {}
    for method, dataset in itertools.product(suite.methods, suite.datasets):
        chosen = {**(suite.options or {}), **(dataset.options or {}), **(method.options or {})}
        cameras = method.cameras or suite.cameras or ["erp"]
        for sequence in _sequences(dataset, notes):
            for camera, seed, repeat in itertools.product(cameras, suite.seeds or [0], range(suite.repeats)):
                cell = _cell(method, dataset, sequence, camera, seed, repeat, chosen, path)
                cells.setdefault(cell.identity, cell)
                if len(cells) > MAX_CELLS:
                    raise InputError(f"more than {MAX_CELLS} cells", path)
    return Suite(suite.name or path.stem, tuple(cells.values()), tuple(dict.fromkeys(notes)))


def _cell(
    method: MethodEntry,
    dataset: DatasetEntry,
    sequence: str | None,
    camera: str,
    seed: int,
    repeat: int,
    options: Mapping[str, Any],
    path: Path,
) -> Cell:
    try:
        request = RunRequest(
            method=method.name,
            preset=method.preset,
            settings=dict(method.set or {}),
            camera=camera,
            dataset=dataset.name,
            root=dataset.root,
            sequence=sequence,
            seed=seed,
            **{k: v for k, v in options.items() if k in own_options()},
        )
        limits = Limits(**{k: v for k, v in options.items() if k in LIMITS})
    except InputError:
        raise
    except PanobenchError as error:
        raise InputError(str(error), path) from error
    return Cell(request, repeat, limits)


def _sequences(dataset: DatasetEntry, notes: list[str]) -> Iterator[str | None]:
    """The sequences that are named, or all there are. A dataset that is missing keeps one row, which will say so."""
    if dataset.sequences == "all":
        from panobench.datasets.open import open_dataset

        try:
            yield from open_dataset(dataset.name, dataset.root).sequences()
        except (DatasetError, UnavailableError) as error:
            notes.append(f"the sequences of {dataset.name} cannot be listed: {error}")
            yield None
    elif dataset.sequences is None:
        yield None
    else:
        yield from dataset.sequences

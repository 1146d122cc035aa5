"""Read suite files: a YAML matrix of methods, cameras, datasets and seeds is expanded into cells.

Every mistake in a file is an InputError or UnknownNameError that names the file and the entry.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_args

from panobench.bench.cells import Cell, Limits
from panobench.bench.request import RunOption, RunRequest, run_options
from panobench.errors import DatasetError, InputError, PanobenchError, UnavailableError, UnknownNameError
from panobench.plugins import registry
from panobench.reading import parse_yaml, read_text
from panobench.specs import DatasetSpec, MethodSpec

MAX_CELLS = 100_000
_KEYS = ("name", "methods", "cameras", "datasets", "seeds", "repeats", "options")
_METHOD_KEYS = ("name", "preset", "set", "cameras", "options")
_DATASET_KEYS = ("name", "root", "sequences", "options")
_LIMITS = tuple(f.name for f in fields(Limits))


@dataclass(frozen=True)
class Suite:
    """A suite's name and its cells in the file's order. notes: a line for each dataset that could not be listed."""

    name: str
    cells: tuple[Cell, ...]
    notes: tuple[str, ...] = field(default=())


def read_suite(path: Path) -> Suite:
    """Parse a suite file and expand it. Raises InputError or UnknownNameError."""
    document = _mapping(_load(path), path, "a suite")
    _known(document, _KEYS, "suite key")
    options = _options(document.get("options"), path)
    methods = [_entry(m, _METHOD_KEYS, path, "methods") for m in _list(document, "methods", path)]
    cameras = [_text(c, path, "cameras") for c in _list(document, "cameras", path, default=["erp"])]
    datasets = [_entry(d, _DATASET_KEYS, path, "datasets") for d in _list(document, "datasets", path)]
    seeds = [_integer(s, path, "seeds") for s in _list(document, "seeds", path, default=[0])]
    repeats = _integer(document.get("repeats", 1), path, "repeats")
    if repeats > MAX_CELLS:
        raise InputError(f"repeats: more than {MAX_CELLS} cells", path)
    for method in methods:
        registry().get(MethodSpec, method["name"])
    for dataset in datasets:
        registry().get(DatasetSpec, dataset["name"])
    notes: list[str] = []
    cells: dict[str, Cell] = {}
    for method, dataset in itertools.product(methods, datasets):
        chosen = {**options, **_options(dataset.get("options"), path), **_options(method.get("options"), path)}
        own = _list(method, "cameras", path, default=cameras)
        for sequence in _sequences(dataset, path, notes):
            for camera, seed, repeat in itertools.product(own, seeds, range(repeats)):
                cell = _cell(method, dataset, sequence, _text(camera, path, "cameras"), seed, repeat, chosen, path)
                cells.setdefault(cell.identity, cell)
                if len(cells) > MAX_CELLS:
                    raise InputError(f"more than {MAX_CELLS} cells", path)
    return Suite(str(document.get("name") or path.stem), tuple(cells.values()), tuple(dict.fromkeys(notes)))


def _load(path: Path) -> Any:
    return parse_yaml(read_text(path, "the suite file"), path)


def _cell(
    method: Mapping[str, Any],
    dataset: Mapping[str, Any],
    sequence: str | None,
    camera: str,
    seed: int,
    repeat: int,
    options: Mapping[str, Any],
    path: Path,
) -> Cell:
    try:
        request = RunRequest(
            method=method["name"],
            preset=_optional(method.get("preset"), path, "preset"),
            settings=_settings(method.get("set"), path),
            camera=camera,
            dataset=dataset["name"],
            root=_optional(dataset.get("root"), path, "root"),
            sequence=sequence,
            seed=seed,
            **{k: v for k, v in options.items() if k in _run_options()},
        )
        limits = Limits(**{k: v for k, v in options.items() if k in _LIMITS})
    except InputError:
        raise
    except PanobenchError as error:
        raise InputError(str(error), path) from error
    return Cell(request, repeat, limits)


def _sequences(dataset: Mapping[str, Any], path: Path, notes: list[str]) -> Iterator[str | None]:
    """The sequences that are named, or all there are. A dataset that is missing keeps one row, which will say so."""
    chosen = dataset.get("sequences")
    if chosen == "all":
        from panobench.datasets.open import open_dataset

        try:
            root = _optional(dataset.get("root"), path, "root")
            yield from open_dataset(dataset["name"], root).sequences()
        except (DatasetError, UnavailableError) as error:
            notes.append(f"the sequences of {dataset['name']} cannot be listed: {error}")
            yield None
    elif chosen is None:
        yield None
    else:
        for name in _list(dataset, "sequences", path):
            yield _text(name, path, "sequences")


def _options(value: Any, path: Path) -> dict[str, Any]:
    options = _mapping(value if value is not None else {}, path, "options")
    known = _run_options()
    _known(options, (*known, *_LIMITS), "option")
    for key, value in options.items():
        if key in known and str in (known[key].type, *get_args(known[key].type)) and value is not None:
            options[key] = _text(value, path, key)
    return options


def _run_options() -> dict[str, RunOption]:
    """The run options that may stand under ``options``: those that have no key of their own."""
    return {option.name: option for option in run_options() if not option.suite_key}


def _entry(value: Any, keys: tuple[str, ...], path: Path, where: str) -> dict[str, Any]:
    """A method or dataset as a mapping; the file may give its name alone."""
    entry = {"name": value} if isinstance(value, str) else _mapping(value, path, f"an entry of {where}")
    _known(entry, keys, f"key of {where}")
    if "name" not in entry:
        raise InputError(f"an entry of {where} has no name", path)
    entry["name"] = _text(entry["name"], path, where)
    return entry


def _settings(value: Any, path: Path) -> dict[str, Any]:
    settings = _mapping(value if value is not None else {}, path, "set")
    for key, item in settings.items():
        items = item if isinstance(item, list) else [item]
        if not all(i is None or isinstance(i, (bool, int, float, str)) for i in items):
            raise InputError(f"set: {key} must be a plain value or a list of such", path)
    return settings


def _mapping(value: Any, path: Path, what: str) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{what} must be a mapping, not {_type(value)}", path)
    if not all(isinstance(key, str) for key in value):
        raise InputError(f"{what} has a key that is no text", path)
    return dict(value)


def _list(document: Mapping[str, Any], key: str, path: Path, default: list[Any] | None = None) -> list[Any]:
    value = document.get(key)
    value = default if value is None else value
    if isinstance(value, (str, Mapping)):
        value = [value]
    if not isinstance(value, list) or not value:
        raise InputError(f"{key} must be a list with at least one entry", path)
    return value


def _known(values: Mapping[str, Any], keys: tuple[str, ...], what: str) -> None:
    for key in values:
        if key not in keys:
            raise UnknownNameError(what, key, keys)


def _text(value: Any, path: Path, where: str) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise InputError(f"{where}: expected a name, not {_type(value)}", path)
    return str(value)


def _optional(value: Any, path: Path, where: str) -> str | None:
    return None if value is None else _text(value, path, where)


def _integer(value: Any, path: Path, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise InputError(f"{where}: expected a whole number, not {value!r:.40}", path)
    return value


def _type(value: Any) -> str:
    return "nothing" if value is None else type(value).__name__

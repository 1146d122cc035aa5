"""Artifacts: files beside code and data that a result depends on, such as networks, vocabularies and programs.

They count by content, as code and data do: a network that is trained again under its old name gives new results.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from panobench.bench.run.config import config_values
from panobench.bench.run.masking import choose_mask
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import open_depth
from panobench.datasets.files.checksums import known_sha256
from panobench.errors import InputError, PanobenchError, UnavailableError
from panobench.plugins import registry
from panobench.specs import MethodSpec, MetricSpec, load_object


def artifact_checksums(request: RunRequest, spec: MethodSpec, config: Any) -> dict[str, str]:
    """SHA-256 of every artifact that a run reads, by what it is used for.

    Artifacts are named by a method's options, by a spec's ``files`` function, and by adapters to other programs. The
    folder an artifact is in does not count. Raises a PanobenchError for a depth estimator that is not available.
    """
    found: dict[str, str] = {}
    for key, text in _texts("", config_values(config)):
        path = _file(text)
        if path is not None:
            found[f"option {key}"] = _checksum(path)
    _add(found, "method", [*_named(spec.files, config, spec.name), *_program(spec, config)])
    depth = open_depth(request.depth) if request.depth is not None else None
    if depth is not None:
        _add(found, "depth", _named(depth.spec.files, depth.argument, depth.name))
    mask = choose_mask(request.mask, request.dataset)
    if mask.file is not None:
        found["mask"] = _checksum(mask.file)
    elif mask.spec is not None:
        _add(found, "mask", _named(mask.spec.files, mask.argument, mask.spec.name))
    for metric in registry().specs(MetricSpec).values():
        try:
            _add(found, f"metric {metric.name}", _named(metric.files, None, metric.name))
        except PanobenchError as error:  # the run goes on without a metric that is not available, and notes it
            found[f"metric {metric.name}"] = str(error)
    return found


def _named(function: str | None, argument: Any, name: str) -> list[Path]:
    """The files that a spec's ``files`` function returns. Raises PanobenchError, whatever that function raises."""
    if not function:
        return []
    try:
        return [Path(path) for path in load_object(function, f"'{name}'")(argument)]
    except PanobenchError:
        raise
    except Exception as error:
        raise UnavailableError(f"{function} of '{name}' failed: {type(error).__name__}: {error}") from error


def _program(spec: MethodSpec, config: Any) -> Iterable[Path]:
    """The program that an adapter runs; nothing for methods that are no ``ExternalMethod``."""
    from panobench.external.adapter import ExternalConfig, ExternalMethod

    if not isinstance(config, ExternalConfig):
        return ()
    method = spec.load()(config)
    return method.files() if isinstance(method, ExternalMethod) else ()


def _add(found: dict[str, str], what: str, paths: Iterable[Path]) -> None:
    for number, path in enumerate(paths):
        found[f"{what} {number}"] = _checksum(path)


def _texts(key: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _texts(f"{key}.{name}" if key else str(name), inner)
    elif isinstance(value, (list, tuple)):
        for number, inner in enumerate(value):
            yield from _texts(f"{key}.{number}", inner)


def _file(text: str) -> Path | None:
    """The file that an option names, if it names one that is there; a bare word is a choice, not a file."""
    if os.sep not in text:
        return None
    try:
        path = Path(text).expanduser()
        return path if path.is_file() else None
    except (
        OSError,
        ValueError,
        RuntimeError,
    ):  # the name is too long, has a zero byte, or names an unknown user's home
        return None


def _checksum(path: Path) -> str:
    try:
        return known_sha256(path)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path) from error

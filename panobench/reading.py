"""Reading files that anybody may have written: bounded size, strict text, YAML and JSON, one clean error for all.

``error`` is the class that is raised, called as InputError is: (message, path, line=...).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import InputError

#: A small text file: settings, a calibration, a suite.
SMALL_BYTES = 1 << 20
#: Values that a YAML file may have once its aliases are written out; a few lines can stand for billions.
MAX_VALUES = 1_000_000
#: Digits of a whole number in JSON that still fits a float.
_MAX_DIGITS = 300

Error = type[InputError]


def read_bytes(path: Path, what: str, limit: int = SMALL_BYTES, error: Error = InputError) -> bytes:
    """The file's content. Raises ``error`` when it is missing, cannot be read or is over ``limit`` bytes."""
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except FileNotFoundError:
        raise error(f"{what} is missing", path) from None
    except OSError as cause:
        raise error(f"{what} cannot be read ({cause.strerror})", path) from cause
    except ValueError:  # a NUL in the path
        raise error(f"{what} has an impossible name", str(path).replace("\0", "?")) from None
    if len(data) > limit:
        size = f"{limit >> 20} MiB" if limit >= 1 << 20 else f"{limit >> 10} KiB"
        raise error(f"over {size}, too large for {what.removeprefix('the ')}", path)
    return data


def read_text(path: Path, what: str, limit: int = SMALL_BYTES, error: Error = InputError) -> str:
    """The file's text, UTF-8 without NUL. Raises ``error`` when it is missing, over ``limit`` bytes or not text."""
    data = read_bytes(path, what, limit, error)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error("not UTF-8 text", path) from None
    if "\0" in text:
        raise error("not a text file", path)
    return text


def parse_yaml(text: str, path: Path, error: Error = InputError) -> Any:
    """Plain values of a YAML text. Raises ``error`` with the line; also for aliases that expand without bound."""
    import yaml

    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as cause:
        mark = getattr(cause, "problem_mark", None)
        problem = getattr(cause, "problem", None) or "not YAML"
        raise error(f"not valid YAML: {problem}", path, line=mark.line + 1 if mark else None) from None
    except Exception as cause:  # PyYAML lets out whatever its constructors raise: KeyError, ValueError, ...
        raise error(f"not usable YAML ({type(cause).__name__})", path) from None
    if _expanded(values, {}) > MAX_VALUES:
        raise error("its aliases stand for more than a million values, or for themselves", path)
    return values


def _expanded(value: Any, known: dict[int, float]) -> float:
    """How many values there are with aliases written out; infinite for a value that contains itself."""
    if not isinstance(value, (dict, list, tuple, set)):
        return 1.0
    if id(value) not in known:
        known[id(value)] = float("inf")
        inside = [*value, *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1.0 + sum(_expanded(v, known) for v in inside)
    return known[id(value)]


def parse_json(text: str, path: Path, error: Error = InputError) -> Any:
    """Values of a strict JSON text: no NaN, no infinity, no number beyond float64. Raises ``error`` with the line."""
    try:
        return json.loads(text, parse_constant=_refuse, parse_float=_float, parse_int=_int)
    except json.JSONDecodeError as cause:
        raise error(f"not valid JSON ({cause.msg})", path, line=cause.lineno) from None
    except (ValueError, RecursionError) as cause:
        raise error(f"not valid JSON ({cause})", path) from None


def _refuse(text: str) -> Any:
    raise ValueError(f"{text} is not a number in JSON")


def _float(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError("a number is too large")
    return value


def _int(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError("a number is too large")
    return int(text)


def number_array(values: Any) -> NDArray[np.float64]:
    """Nested lists as a finite float64 array, or an empty one for anything that is not made of finite numbers."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(0)
    return array if np.isfinite(array).all() else np.zeros(0)


def inside(folder: Path, name: str) -> Path | None:
    """``folder / name`` if the name stays below the folder and can be one, else None."""
    relative = Path(name)
    if relative.is_absolute() or ".." in relative.parts or not relative.parts or "\0" in name or len(name) > 1024:
        return None
    return folder / relative

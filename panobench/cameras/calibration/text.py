"""Reading text files that anybody may have written: bounded size, strict YAML, errors with line numbers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml

from panobench import reading
from panobench.errors import CalibrationError

#: No calibration is larger; a bigger file is something else.
MAX_BYTES = 1 << 20


class Table(dict[str, Any]):
    """A YAML mapping that knows its file and the line (from 1) of each of its keys."""

    path: Path | None = None
    line: int | None = None
    lines: dict[str, int]

    def error(self, message: str, key: str | None = None) -> CalibrationError:
        """An error at ``key``'s line, or at the table's."""
        line = self.lines.get(key, self.line) if key is not None else self.line
        return CalibrationError(message, self.path, line=line)

    def need(self, key: str) -> Any:
        """The value of ``key``. Raises CalibrationError if it is missing."""
        if key not in self:
            raise self.error(f"'{key}' is missing")
        return self[key]

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number."""
        if key not in self and default is not None:
            return default
        return as_number(self.need(key), lambda message: self.error(f"'{key}' {message}", key))

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        """A list of ``count`` finite numbers (None: any)."""
        value = self.need(key)
        if not isinstance(value, list):
            raise self.error(f"'{key}' must be a list of numbers", key)
        if count is not None and len(value) != count:
            raise self.error(f"'{key}' must have {count} numbers, not {len(value)}", key)
        return [as_number(v, lambda message: self.error(f"'{key}' {message}", key)) for v in value]

    def table(self, key: str) -> Table:
        value = self.need(key)
        if not isinstance(value, Table):
            raise self.error(f"'{key}' must be a table", key)
        return value

    def plain(self) -> dict[str, Any]:
        """The same values as ordinary dicts."""
        return {k: v.plain() if isinstance(v, Table) else v for k, v in self.items()}


def as_number(value: Any, error: Callable[[str], CalibrationError]) -> float:
    """A finite float, else ``error``; also from text such as 1e-3, which YAML 1.1 takes for a string."""
    try:
        number = float("nan") if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not -1e300 < number < 1e300:
        raise error(f"must be a finite number, not {_short(value)}")
    return number


def _short(value: Any) -> str:
    """A value for a message; Python does not spell whole numbers of more than 4,300 digits."""
    try:
        return repr(value)[:80]
    except ValueError:
        return "a whole number of thousands of digits"


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The file's content, whatever it is. Raises CalibrationError when missing or too large."""
    return reading.read_bytes(path, "the calibration file", limit, CalibrationError)


def read_text(path: Path, limit: int = MAX_BYTES) -> str:
    """The file's text (UTF-8). Raises CalibrationError when missing, too large or not text."""
    text = reading.read_text(path, "the calibration file", limit, CalibrationError)
    if not text.strip():
        raise CalibrationError("the file is empty", path)
    return text


class _Loader(yaml.SafeLoader):
    """Safe YAML without aliases or repeated keys; mappings become ``Table``."""

    file: Path | None = None

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.constructor.ConstructorError(None, None, "aliases are not allowed", event.start_mark)
        return super().compose_node(parent, index)


def _construct_table(loader: _Loader, node: yaml.Node) -> Table:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, "a table is expected", node.start_mark)
    table = Table()
    table.path, table.line, table.lines = loader.file, node.start_mark.line + 1, {}
    for key_node, value_node in node.value:
        key = str(loader.construct_object(key_node, deep=True))
        line = key_node.start_mark.line + 1
        if key in table:
            raise CalibrationError(f"'{key}' is given twice", loader.file, line=line)
        table[key], table.lines[key] = loader.construct_object(value_node, deep=True), line
    return table


_Loader.add_constructor("tag:yaml.org,2002:map", _construct_table)
_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _construct_table)
_Loader.add_constructor("tag:yaml.org,2002:opencv-nd-matrix", _construct_table)


def parse_yaml(text: str, path: Path) -> Table:
    """The top-level table of the file's first document. OpenCV's `%YAML:1.0` header and matrices are understood."""
    if text.startswith("%YAML:"):
        text = "#" + text  # the colon is not YAML; a comment keeps the line numbers
    try:
        loader = _Loader(text)
        loader.file = path
        data = loader.get_data() if loader.check_data() else None  # rostopic echo ends each message with ---
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = None if mark is None else mark.line + 1
        raise CalibrationError(f"not valid YAML: {problem}", path, line=line) from None
    except RecursionError:
        raise CalibrationError("not a calibration: nested too deeply", path) from None
    except CalibrationError:
        raise
    except Exception as error:  # PyYAML lets out whatever its constructors raise: KeyError, ValueError, ...
        raise CalibrationError(f"not valid YAML: {error}", path) from None
    if not isinstance(data, Table):
        raise CalibrationError("a table of values is expected", path)
    return data


def data_lines(text: str) -> Iterable[tuple[int, list[str]]]:
    """(line number from 1, words) of the lines that are neither blank nor a # comment."""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if words:
            yield number, words


def write_text(path: Path, text: str) -> None:
    """Replace the file in one step, so that it is never half-written."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise CalibrationError(f"cannot be written ({error.strerror})", path) from error

"""Inspection of an ONNX file before the runtime loads it: which other files it reads, and which operators it needs.

ONNX is protobuf. Only the few fields that are needed are decoded, and weights are skipped, not copied (wire format:
protobuf.dev/programming-guides/encoding; field numbers: onnx.proto3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from panobench.errors import InputError
from panobench.reading import inside

#: A single ONNX file cannot be larger.
MAX_BYTES = 2 << 30
#: Operator sets that are part of the runtime. Others are custom, and need code that is not loaded.
KNOWN_DOMAINS = frozenset({"", "ai.onnx", "ai.onnx.ml", "com.microsoft"})
_MAX_DEPTH = 40

# Messages to descend into, by (message, field number).
_INSIDE = {
    ("model", 7): "graph",
    ("model", 25): "function",
    ("graph", 1): "node",
    ("graph", 5): "tensor",
    ("graph", 15): "sparse",
    ("function", 7): "node",
    ("node", 5): "attribute",
    ("attribute", 5): "tensor",
    ("attribute", 6): "graph",
    ("attribute", 10): "tensor",
    ("attribute", 11): "graph",
    ("attribute", 22): "sparse",
    ("attribute", 23): "sparse",
    ("sparse", 1): "tensor",
    ("sparse", 2): "tensor",
    ("tensor", 13): "entry",
}
_TEXTS = {("node", 4), ("node", 7), ("entry", 1), ("entry", 2), ("function", 1), ("function", 10)}


@dataclass
class Contents:
    """external: paths of external data as written in the file. custom: operators of unknown domains, "domain::name".
    functions: those that the file defines itself.
    """

    external: set[str] = field(default_factory=set)
    custom: set[str] = field(default_factory=set)
    functions: set[str] = field(default_factory=set)


def read_contents(path: Path) -> Contents:
    """Read the file. Raises InputError if it is too large or not protobuf."""
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"over {MAX_BYTES >> 30} GiB, too large for a network", path)
    contents = Contents()
    try:
        _walk(memoryview(path.read_bytes()), "model", contents, 0)
    except (ValueError, IndexError):
        raise InputError("not an ONNX file, or a damaged one", path) from None
    contents.custom -= contents.functions
    return contents


def check_contents(path: Path) -> None:
    """Raises InputError unless all of the network is in its folder and it needs no custom operators."""
    contents = read_contents(path)
    folder = path.resolve().parent
    for name in sorted(contents.external):
        target = inside(folder, name)
        if target is None or not target.resolve().is_relative_to(folder):
            raise InputError(f"its weights are in '{name}', outside its folder: not read", path)
        if not target.is_file():
            raise InputError(f"its weights are in '{name}', which is not beside it", path)
        if target.stat().st_size > 4 * MAX_BYTES:
            raise InputError(f"its weights in '{name}' are too large", path)
    if contents.custom:
        raise InputError(
            f"needs custom operators ({', '.join(sorted(contents.custom)[:3])}), which are not loaded", path
        )


def _walk(data: memoryview, message: str, found: Contents, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise ValueError("nested too deeply")
    texts: dict[int, str] = {}
    for number, value in _fields(data):
        key = (message, number)
        if key in _INSIDE:
            _walk(value, _INSIDE[key], found, depth + 1)
        elif key in _TEXTS:
            texts[number] = bytes(value[:4096]).decode("utf-8", "replace")
    if message == "node" and texts.get(7, "") not in KNOWN_DOMAINS:
        found.custom.add(f"{texts[7]}::{texts.get(4, '')}")
    elif message == "function":
        found.functions.add(f"{texts.get(10, '')}::{texts.get(1, '')}")
    elif message == "entry" and texts.get(1) == "location":
        found.external.add(texts.get(2, ""))


def _fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """The length-delimited fields. Raises ValueError or IndexError for data that are not protobuf."""
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise ValueError("field 0")
        if kind == 0:
            _, at = _varint(data, at)
        elif kind == 1:
            at += 8
        elif kind == 2:
            length, at = _varint(data, at)
            if length > end - at:
                raise ValueError("beyond the end")
            yield number, data[at : at + length]
            at += length
        elif kind == 5:
            at += 4
        else:
            raise ValueError("unknown wire type")
    if at != end:
        raise ValueError("beyond the end")


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number without end")

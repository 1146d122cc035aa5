"""Gaussian maps as the standard 3DGS PLY that splat viewers open.

One ``vertex`` element with float32 properties ``x y z nx ny nz f_dc_0..2 opacity scale_0..2 rot_0..3``:
log-scales, opacity logit, quaternion (w, x, y, z) and the degree-0 spherical harmonic,
``colour = 0.5 + f_dc * SH_C0``. Format: Turk, "The PLY Polygon File Format" (1994).

Maps come from anywhere, and plyfile, which writes our meshes, believes headers: 150 bytes that claim 40 million lists
cost it 0.3 GB and seconds, a count beyond the file is a MemoryError, or, with its memory map, a file that shrinks
while it is read ends the process. Here what is claimed is held against the file's size first.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.errors import InputError

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi))."""

_MEAN = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_COLOUR = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_NEEDED = (*_MEAN, *_COLOUR, "opacity", *_SCALE, *_ROTATION)

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_BYTE_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_LINE = 4096
_MAX_HEADER_LINES = 4096

Float = NDArray[np.float32]


class PlyGaussians(NamedTuple):
    """Float32 parameters in the order of ``GaussianMap``'s constructor; shapes as in ``write_ply``."""

    means: Float
    log_scales: Float
    quats: Float
    opacity_logits: Float
    colours: Float


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)  # (name, numpy type without byte order)
    has_list: bool = False


@dataclass
class _Header:
    format: str
    elements: list[_Element]
    lines: int


def write_ply(
    path: Path | str,
    means: ArrayLike,
    log_scales: ArrayLike,
    quats: ArrayLike,
    opacity_logits: ArrayLike,
    colours: ArrayLike,
    *,
    harmonics: int = 0,
) -> None:
    """Write Gaussians as binary little-endian PLY; the file appears whole or not at all.

    means, log_scales, colours (N, 3), quats (N, 4) as (w, x, y, z), opacity_logits (N,). Colours are RGB in
    0..1. harmonics: so many ``f_rest_*`` are written, all zero; 45 make degree 3. Raises ValueError for other shapes.
    """
    m = np.asarray(means, dtype=np.float32)
    n = len(m)
    groups: dict[tuple[str, ...], NDArray[Any]] = {
        _MEAN: m,
        _NORMAL: np.zeros((n, 3), np.float32),
        _COLOUR: (np.asarray(colours, dtype=np.float64) - 0.5) / SH_C0,
        tuple(f"f_rest_{k}" for k in range(harmonics)): np.zeros((n, harmonics), np.float32),
        ("opacity",): np.asarray(opacity_logits, dtype=np.float32).reshape(-1, 1),
        _SCALE: np.asarray(log_scales, dtype=np.float32),
        _ROTATION: np.asarray(quats, dtype=np.float32),
    }
    for names, values in groups.items():
        if values.shape != (n, len(names)):
            raise ValueError(f"{'/'.join(names[:1])}...: shape {values.shape}, expected {(n, len(names))}")
    rows = np.concatenate([v.astype("<f4") for v in groups.values()], axis=1)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {name}" for names in groups for name in names] + ["end_header", ""]

    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as f:
            f.write("\n".join(header).encode("ascii"))
            f.write(np.ascontiguousarray(rows).tobytes())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def read_ply(path: Path | str) -> PlyGaussians:
    """Read a 3DGS PLY, binary of either byte order or ascii; ``GaussianMap(*read_ply(path))`` is the map.

    Properties beyond the needed ones (normals, ``f_rest_*`` of higher degree) are ignored. Raises InputError
    for anything that is not such a file: a header that claims more than the file holds is refused before
    memory is reserved for it, and so are non-finite values and zero quaternions, which cannot be rendered.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        with open(path, "rb") as f:
            header = _read_header(f, path)
            index = _vertex_index(header, path)
            vertex = header.elements[index]
            if header.format == "ascii":
                columns = _read_ascii(f, header, index, size - f.tell(), path)
            else:
                columns = _read_binary(f, header, index, size, path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", path) from error

    def gather(names: tuple[str, ...]) -> Float:
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.stack([columns[name].astype(np.float32) for name in names], axis=1)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(bad):
            raise InputError(f"vertex {bad[0]} of {vertex.count}: {names[0]}... is not finite in float32", path)
        return values

    quats = gather(_ROTATION)
    zero = np.flatnonzero(~(np.abs(quats).max(axis=1, initial=0.0) > 0.0))
    if len(zero):
        raise InputError(f"vertex {zero[0]} of {vertex.count}: the quaternion rot_0..3 is zero", path)
    dc = gather(_COLOUR)
    return PlyGaussians(
        means=gather(_MEAN),
        log_scales=gather(_SCALE),
        quats=quats,
        opacity_logits=gather(("opacity",))[:, 0],
        colours=(0.5 + dc.astype(np.float64) * SH_C0).astype(np.float32),
    )


def _read_header(f: BinaryIO, path: Path) -> _Header:
    if f.readline(_MAX_LINE).rstrip(b"\r\n") != b"ply":
        raise InputError("not a PLY file (the first line must be 'ply')", path, line=1)
    fmt: str | None = None
    elements: list[_Element] = []
    for number in range(2, _MAX_HEADER_LINES):
        raw = f.readline(_MAX_LINE)
        if not raw.endswith(b"\n"):
            raise InputError("the PLY header has no 'end_header' (file truncated?)", path, line=number)
        try:
            words = raw.decode("ascii").split()
        except UnicodeDecodeError:
            words = raw.decode("latin-1").split()
            if not words or words[0] not in ("comment", "obj_info"):
                raise InputError("the PLY header is not ascii text", path, line=number) from None
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words == ["end_header"]:
            if fmt is None:
                raise InputError("the PLY header has no 'format' line", path, line=number)
            return _Header(fmt, elements, number)
        if words[0] == "format" and fmt is None:
            fmt = _parse_format(words, path, number)
        elif words[0] == "element":
            elements.append(_parse_element(words, path, number))
        elif words[0] == "property" and elements:
            _add_property(elements[-1], words, path, number)
        else:
            raise InputError(f"unexpected PLY header line '{' '.join(words)[:80]}'", path, line=number)
    raise InputError(f"the PLY header has more than {_MAX_HEADER_LINES} lines", path)


def _parse_format(words: list[str], path: Path, number: int) -> str:
    if len(words) != 3 or words[2] != "1.0" or (words[1] != "ascii" and words[1] not in _BYTE_ORDER):
        raise InputError(
            f"unknown PLY format '{' '.join(words[1:])[:80]}': known: ascii 1.0, "
            "binary_little_endian 1.0, binary_big_endian 1.0",
            path,
            line=number,
        )
    return words[1]


def _parse_element(words: list[str], path: Path, number: int) -> _Element:
    # isdecimal alone would take other scripts' digits, but the header is ascii by now; 18 digits fit int64.
    if len(words) != 3 or not words[2].isdecimal() or len(words[2]) > 18:
        raise InputError(f"bad element line '{' '.join(words)[:80]}' (want: element NAME COUNT)", path, line=number)
    return _Element(words[1], int(words[2]))


def _add_property(element: _Element, words: list[str], path: Path, number: int) -> None:
    if len(words) == 5 and words[1] == "list":
        element.has_list = True
        return
    if len(words) != 3:
        raise InputError(f"bad property line '{' '.join(words)[:80]}'", path, line=number)
    if words[1] not in _TYPES:
        raise InputError(f"unknown PLY type '{words[1][:80]}' of property '{words[2][:80]}'", path, line=number)
    if any(name == words[2] for name, _ in element.properties):
        raise InputError(f"property '{words[2][:80]}' appears twice", path, line=number)
    element.properties.append((words[2], _TYPES[words[1]]))


def _vertex_index(header: _Header, path: Path) -> int:
    names = [e.name for e in header.elements]
    if names.count("vertex") != 1:
        raise InputError(f"{names.count('vertex')} 'vertex' elements in the PLY header, expected one", path)
    index = names.index("vertex")
    vertex = header.elements[index]
    if vertex.has_list:
        raise InputError("the 'vertex' element has a list property; a Gaussian map has none", path)
    have = {name for name, _ in vertex.properties}
    missing = [name for name in _NEEDED if name not in have]
    if missing:
        raise InputError(f"not a Gaussian map: the 'vertex' element lacks {', '.join(missing)}", path)
    return index


def _dtype(element: _Element, order: str) -> np.dtype[Any]:
    return np.dtype([(name, order + kind) for name, kind in element.properties])


def _too_short(count: int, need: int, have: int, path: Path) -> InputError:
    return InputError(f"the header claims {count} vertices ({need} bytes or more), the file has {have} for them", path)


def _read_binary(f: BinaryIO, header: _Header, index: int, size: int, path: Path) -> dict[str, NDArray[Any]]:
    order = _BYTE_ORDER[header.format]
    offset = f.tell()
    for element in header.elements[:index]:
        if element.has_list:
            raise InputError(f"element '{element.name[:80]}' before 'vertex' has lists: not supported", path)
        offset += element.count * _dtype(element, order).itemsize
    vertex = header.elements[index]
    dtype = _dtype(vertex, order)
    need, have = vertex.count * dtype.itemsize, max(0, size - offset)
    if need > have:
        raise _too_short(vertex.count, need, have, path)
    f.seek(offset)
    data = f.read(need)
    if len(data) != need:
        raise _too_short(vertex.count, need, len(data), path)
    rows = np.frombuffer(data, dtype=dtype, count=vertex.count)
    return {name: rows[name] for name, _ in vertex.properties}


def _read_ascii(f: BinaryIO, header: _Header, index: int, have: int, path: Path) -> dict[str, NDArray[Any]]:
    vertex = header.elements[index]
    width = len(vertex.properties)
    need = 2 * vertex.count * width - 1 if vertex.count else 0  # a digit and a separator per value
    if need > have:
        raise _too_short(vertex.count, need, have, path)
    skip = sum(e.count for e in header.elements[:index])
    rows = np.empty((vertex.count, width), np.float64)
    done = 0
    for number, line in enumerate(f, start=header.lines + 1):
        if done == vertex.count:
            break
        words = line.split()
        if not words:
            continue
        if skip > 0:
            skip -= 1
            continue
        if len(words) != width:
            raise InputError(f"vertex {done} has {len(words)} values, expected {width}", path, line=number)
        try:
            rows[done] = [float(w) for w in words]
        except ValueError:
            raise InputError(f"vertex {done} has a value that is not a number", path, line=number) from None
        done += 1
    if done < vertex.count:
        raise InputError(f"the header claims {vertex.count} vertices, the file has {done}", path)
    return {name: rows[:, k] for k, (name, _) in enumerate(vertex.properties)}

"""Damage to documents: what a fuzzing campaign does to valid ones. Pure functions of bytes and three small numbers."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass

_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
#: Numbers that parsers trip over, as text.
NUMBERS = [
    b"0", b"-0", b"1", b"-1", b"0.5", b"1e-320", b"1e-30", b"1e9", b"-1e9", b"1e30", b"1e200", b"1e308", b"1e309",
    b"nan", b"NaN", b"inf", b"-inf", b".inf", b".nan", b"Infinity", b"-Infinity", b"2147483647", b"2147483648",
    b"4294967296", b"9223372036854775807", b"9223372036854775808", b"-9223372036854775809", b"1000000000000",
    b"9" * 400, b"1" * 5000, b"0x10", b"0o7", b"1_000", b"1:30", b"1.", b".5", b"+5", b"1e", b"--1", b"1,5",
    b"2001-02-30", b"true", b"null", b"~", b'""', b"[]", b"{}", b"16384", b"65536",
]  # fmt: skip
#: Pieces of syntax that mean something to some format.
PIECES = [
    b"\0", b"\r", b"\r\n", b"\n", b"\t", b" ", b"#", b":", b"-", b"- ", b"[", b"]", b"{", b"}", b",", b"&a ", b"*a",
    b"!!python/object/apply:os.system ['true']", b"!!binary ", b"!!timestamp ", b"!!set ", b"!!omap ", b"<<: ", b"? ",
    b"%YAML:1.0\n", b"---\n", b"...\n", b"|", b">", b"'", b'"', b"\\", b"/", b"../", b"../../../../etc/passwd",
    b"\xff", b"\xfe\xff", b"\xef\xbb\xbf", b"\xc2\x85", b"\xe2\x80\xa8", b"\xf0\x9f\x98\x80", b"\xed\xa0\x80",
    b"\xd9\xa1", b"\xc2\xb2", b"<script>", b"\x1f", b"\x0b", b"\x0c", b"\x1c",
]  # fmt: skip
Change = tuple[int, int, int]


@dataclass(frozen=True)
class Material:
    """What a target starts from: valid documents, and words of its format."""

    documents: tuple[bytes, ...]
    words: tuple[bytes, ...] = ()


def change(number: int) -> Change:
    """One number below 2^51 as a change."""
    return number >> 34, number >> 17 & 0x1FFFF, number & 0x1FFFF


def damaged(material: Material, document: int, changes: Iterable[Change]) -> bytes:
    """One of the documents after some changes; each is (kind, where, what), taken modulo what there is."""
    documents = (*material.documents, b"")
    data = documents[document % len(documents)]
    for kind, where, what in changes:
        data = CHANGES[kind % len(CHANGES)](data, where, what, material)
    return data


def _span(pattern: re.Pattern[bytes], data: bytes, where: int) -> tuple[int, int] | None:
    found = [m.span() for m in pattern.finditer(data[:20000])]
    return found[where % len(found)] if found else None


def _number(data: bytes, where: int, what: int, material: Material) -> bytes:
    span = _span(_NUMBER, data, where)
    return data if span is None else data[: span[0]] + NUMBERS[what % len(NUMBERS)] + data[span[1] :]


def _near_number(data: bytes, where: int, what: int, material: Material) -> bytes:
    """Another plausible number in place of one."""
    span = _span(_NUMBER, data, where)
    return data if span is None else data[: span[0]] + f"{(what - 32768) / 64:g}".encode() + data[span[1] :]


def _word(data: bytes, where: int, what: int, material: Material) -> bytes:
    span = _span(_WORD, data, where)
    if span is None or not material.words:
        return data
    return data[: span[0]] + material.words[what % len(material.words)] + data[span[1] :]


def _word_to_number(data: bytes, where: int, what: int, material: Material) -> bytes:
    span = _span(_WORD, data, where)
    return data if span is None else data[: span[0]] + NUMBERS[what % len(NUMBERS)] + data[span[1] :]


def _insert(data: bytes, where: int, what: int, material: Material) -> bytes:
    at = where % (len(data) + 1)
    choice = (*PIECES, *material.words, *NUMBERS)
    return data[:at] + choice[what % len(choice)] + data[at:]


def _drop(data: bytes, where: int, what: int, material: Material) -> bytes:
    at = where % (len(data) + 1)
    return data[:at] + data[at + 1 + what % 40 :]


def _cut(data: bytes, where: int, what: int, material: Material) -> bytes:
    return data[: where % (len(data) + 1)]


def _byte(data: bytes, where: int, what: int, material: Material) -> bytes:
    if not data:
        return bytes([what % 256])
    at = where % len(data)
    return data[:at] + bytes([what % 256]) + data[at + 1 :]


def _integer(data: bytes, where: int, what: int, material: Material) -> bytes:
    """A 32-bit field, as binary formats have them."""
    values = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFFE, len(data), 1 << 16, 1 << 24, what)
    at = where % (len(data) + 1)
    return data[:at] + struct.pack("<I" if what & 1 else ">I", values[(what >> 1) % len(values)]) + data[at + 4 :]


def _lines(change: Callable[[list[bytes], int, int], None]) -> Callable[[bytes, int, int, Material], bytes]:
    def apply(data: bytes, where: int, what: int, material: Material) -> bytes:
        lines = data.split(b"\n")
        change(lines, where % len(lines), what % len(lines))
        return b"\n".join(lines)

    return apply


def _drop_line(lines: list[bytes], a: int, b: int) -> None:
    del lines[a]


def _double_line(lines: list[bytes], a: int, b: int) -> None:
    lines.insert(b, lines[a])


def _swap_lines(lines: list[bytes], a: int, b: int) -> None:
    lines[a], lines[b] = lines[b], lines[a]


def _indent(lines: list[bytes], a: int, b: int) -> None:
    lines[a] = b"  " * (1 + b % 3) + lines[a]


def _splice(data: bytes, where: int, what: int, material: Material) -> bytes:
    other = material.documents[what % len(material.documents)]
    at = where % (len(data) + 1)
    return data[:at] + other[what % (len(other) + 1) :]


def _repeat(data: bytes, where: int, what: int, material: Material) -> bytes:
    """A piece many times over: nesting and long runs."""
    at = where % (len(data) + 1)
    return data[:at] + PIECES[what % len(PIECES)] * (1 + (what * 7) % 2000) + data[at:]


CHANGES: tuple[Callable[[bytes, int, int, Material], bytes], ...] = (
    _number, _number, _near_number, _word, _word_to_number, _insert, _drop, _cut, _byte, _integer,
    _lines(_drop_line), _lines(_double_line), _lines(_swap_lines), _lines(_indent), _splice, _repeat,
)  # fmt: skip

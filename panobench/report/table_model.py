"""The model of a table, whatever it shows and whatever format it is written in, and how numbers are printed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from panobench.bench.records.statistics import Summary
from panobench.report.model import Origin
from panobench.report.ranking import ranks

FAILED = "/"
NOT_AVAILABLE = "n/a"
NOT_RUN = "–"


@dataclass(frozen=True)
class Column:
    """A column: ``key`` for machines, ``label`` and ``unit`` for people, ``better`` "lower", "higher" or "none".

    sequence: the column is one sequence's, and the table is about one quantity. group: what stands above several
    columns, in tables of several datasets.
    """

    key: str
    label: str
    unit: str = ""
    better: str = "none"
    numeric: bool = True
    about: str = ""
    sequence: bool = False
    group: str = ""


@dataclass(frozen=True)
class Cell:
    """What is printed (``text``), what is sorted by (``value``), and what stands beside it.

    coverage: share of frames tracked, 0..1. rank: 1 best, 2 second. spread: repeats, quartiles and interval in
    words, separated by "; ". group: what it competes within besides its row's group.
    """

    text: str
    value: float | None = None
    coverage: float | None = None
    failed: bool = False
    rank: int | None = None
    spread: str = ""
    about: str = ""
    repeats: int = 1
    group: str = ""


@dataclass(frozen=True)
class Row:
    """A row: cells in column order. facets: values for filters. target: an anchor to link to. flags: one-word warnings.

    competes: its cells may be the best or second best of their columns, among the rows of its group: those that were
    measured on the same data and under the same conditions. facts: what the row is about, for programs.
    """

    cells: tuple[Cell, ...]
    origin: Origin = "measured"
    facets: dict[str, str] = field(default_factory=dict)
    target: str = ""
    flags: tuple[str, ...] = ()
    competes: bool = True
    group: str = ""
    facts: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """A table with a name for files, a title, a caption, and notes printed below it.

    caption: what holds in every format. below: what the page says besides, of what it prints below a cell's number.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    below: str = ""


def format_number(value: float, digits: int) -> str:
    """A number with fixed digits, thousands separated by a thin space; infinities print as the failure sign."""
    if not math.isfinite(value):
        return FAILED
    return f"{value:,.{digits}f}".replace(",", "\u202f")


def length_unit(values: Sequence[float]) -> tuple[str, float]:
    """("mm", 1000) when a typical value is under 10 cm, else ("m", 1)."""
    ordered = sorted(v for v in values if math.isfinite(v))
    return ("mm", 1e3) if not ordered or ordered[len(ordered) // 2] < 0.1 else ("m", 1.0)


def length_text(value: float, unit: str) -> str:
    """A length already in ``unit``: three significant digits in mm, three decimals in m."""
    if unit == "m":
        return format_number(value, 3)
    return format_number(value, 2 if abs(value) < 10 else 1 if abs(value) < 100 else 0)


def spread_text(summary: Summary, text: Callable[[float], str]) -> str:
    """Count, quartiles and 95% interval of repeats in words, empty for a single run."""
    if summary.count < 2:
        return ""
    words = f"n = {summary.count}; IQR {text(summary.low)}–{text(summary.high)}"
    if summary.interval is not None:
        words += f"; 95% {text(summary.interval[0])}–{text(summary.interval[1])}"
    return words


def mark_ranks(columns: Sequence[Column], rows: list[Row]) -> list[Row]:
    """The same rows with best and second best marked per column and group of rows.

    Published, failed and given cells do not compete.
    """
    for j, column in enumerate(columns):
        if column.key == "succeeded":
            continue
        marks: list[int | None] = [None] * len(rows)
        for group in dict.fromkeys((row.group, row.cells[j].group) for row in rows):
            members = [
                i
                for i, row in enumerate(rows)
                if (row.group, row.cells[j].group) == group
                and row.competes
                and row.origin != "published"
                and not row.cells[j].failed
            ]
            cells = [rows[i].cells[j] for i in members]
            for i, mark in zip(members, ranks([c.text for c in cells], [c.value for c in cells], column.better)):
                marks[i] = mark
        rows = [
            replace(row, cells=(*row.cells[:j], replace(row.cells[j], rank=mark), *row.cells[j + 1 :]))
            for row, mark in zip(rows, marks)
        ]
    return rows


def drop_empty_columns(table: Table) -> Table:
    """The table without numeric columns in which no row has a value or a failure.

    Sequences stay where another has something: rows count how many of them succeeded.
    """
    filled = [
        any(r.cells[j].value is not None or r.cells[j].failed for r in table.rows) for j in range(len(table.columns))
    ]
    some = any(full and column.sequence for full, column in zip(filled, table.columns))
    keep = [
        j for j, column in enumerate(table.columns) if not column.numeric or filled[j] or (some and column.sequence)
    ]
    rows = tuple(replace(r, cells=tuple(r.cells[j] for j in keep)) for r in table.rows)
    return replace(table, columns=tuple(table.columns[j] for j in keep), rows=rows)


def renamed(label: str, names: Mapping[str, str]) -> str:
    """A label with another name: of the whole label, or of its first part, the method's name."""
    if label in names:
        return names[label]
    method, dot, rest = label.partition(" · ")
    bare = method.removesuffix(" †")
    return names.get(bare, bare) + method[len(bare) :] + dot + rest


def natural(text: str) -> list[tuple[int, int, str]]:
    """Sort key that puts room2 before room10."""
    words = re.findall(r"\d{1,18}|\D+", text)  # Python does not convert thousands of digits to a number
    return [(0, int(w), "") if w.isdecimal() else (1, 0, w) for w in words]

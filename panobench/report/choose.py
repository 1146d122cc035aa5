"""Which tables an export has: by name, of all datasets at once, with the columns and names asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from panobench.errors import UnknownNameError, UsageError
from panobench.report.table_model import NOT_RUN, Cell, Column, Row, Table, renamed

#: The name of the accuracy table of all datasets together.
ATE = "ate"


def chosen_tables(
    tables: Sequence[Table], wanted: Sequence[str], columns: Sequence[str] = (), names: Mapping[str, str] | None = None
) -> list[Table]:
    """The tables named, all for none; ``ate`` is one table across datasets.

    columns: the columns to keep beside the first, in this order, by key or heading. names: what to call methods and
    columns, by what they are called. Raises UnknownNameError.
    """
    known = [table.name for table in tables]
    accuracy = [table for table in tables if table.name.startswith(f"{ATE}-")]
    found: list[Table] = []
    for name in wanted:
        if name == ATE and accuracy:
            found.append(across_datasets(accuracy))
        elif name in known:
            found.append(next(table for table in tables if table.name == name))
        else:
            raise UnknownNameError("table", name, [*([ATE] if accuracy else []), *known])
    found = found if wanted else list(tables)
    if columns:
        found = [with_columns(table, columns) for table in found]
    return [_renamed(table, names) for table in found] if names else found


def across_datasets(tables: Sequence[Table]) -> Table:
    """Accuracy tables of several datasets as one: a row per method, the columns of each dataset side by side."""
    if len(tables) == 1:
        return replace(tables[0], name=ATE)
    columns: list[Column] = [tables[0].columns[0]]
    for table in tables:
        dataset = table.name.removeprefix(f"{ATE}-")
        columns += [replace(c, key=f"{dataset}/{c.key}", group=dataset) for c in table.columns[1:]]
    rows: dict[tuple[str, str], Row] = {}
    for row in (row for table in tables for row in table.rows):
        rows.setdefault((row.origin, row.cells[0].text.removesuffix(" †")), row)
    merged = []
    for (origin, label), first in rows.items():
        cells, flags, competes, about = [Cell(label)], dict[str, None](), True, dict(first.facts)
        about.pop("dataset", None)
        for table in tables:
            own = next(
                (r for r in table.rows if (r.origin, r.cells[0].text.removesuffix(" †")) == (origin, label)), None
            )
            cells += own.cells[1:] if own else [Cell(NOT_RUN, about="not run") for _ in table.columns[1:]]
            flags |= dict.fromkeys(own.flags) if own else {}
            competes &= own is None or own.competes
        merged.append(replace(first, cells=tuple(cells), flags=tuple(flags), competes=competes, facts=about))
    merged.sort(key=lambda row: row.origin == "published")
    notes = [
        f"{t.name.removeprefix(ATE + '-')}: {note}" for t in tables for note in t.notes if not note.startswith("†")
    ]
    caption = "ATE RMSE after alignment. Lower is better."
    return Table(ATE, "Trajectory accuracy", caption, tuple(columns), tuple(merged), tuple(dict.fromkeys(notes)))


def with_columns(table: Table, wanted: Sequence[str]) -> Table:
    """The table with its first column and those wanted, in that order. Raises UnknownNameError."""
    index: list[int] = [0]
    for name in wanted:
        hits = [
            j
            for j, column in enumerate(table.columns)
            if name in (column.key, column.label, column.key.rpartition("/")[2])
        ]
        if not hits:
            raise UnknownNameError(f"column of table {table.name}", name, [c.key for c in table.columns[1:]])
        index += [j for j in hits if j not in index]
    rows = tuple(replace(row, cells=tuple(row.cells[j] for j in index)) for row in table.rows)
    return replace(table, columns=tuple(table.columns[j] for j in index), rows=rows)


def _renamed(table: Table, names: Mapping[str, str]) -> Table:
    columns = tuple(
        replace(c, label=names.get(c.label, names.get(c.key, c.label)), group=names.get(c.group, c.group))
        for c in table.columns
    )
    texts = [j for j, column in enumerate(table.columns) if not column.numeric]
    rows = tuple(
        replace(
            row,
            cells=tuple(replace(c, text=renamed(c.text, names)) if j in texts else c for j, c in enumerate(row.cells)),
        )
        for row in table.rows
    )
    return replace(table, columns=columns, rows=rows)


def parse_names(pairs: Iterable[str]) -> dict[str, str]:
    """ "panogs=PanoGS-SLAM" as a mapping. Raises UsageError."""
    names = {}
    for pair in pairs:
        old, sign, new = pair.partition("=")
        if not sign or not old:
            raise UsageError(f"--rename {pair}: give OLD=NEW, as in panogs=PanoGS-SLAM")
        names[old] = new
    return names

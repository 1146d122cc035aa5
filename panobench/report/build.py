"""Write a report file from run folders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from panobench.bench.records.paper import load_published
from panobench.errors import UnknownNameError, UsageError
from panobench.report import privacy
from panobench.report.choose import chosen_tables
from panobench.report.collect import collect
from panobench.report.exports import FORMATS, SUFFIXES, to_csv
from panobench.report.model import Collection
from panobench.report.table_model import Table
from panobench.report.tables import build_tables
from panobench.writing import write_whole

#: Size of a page without pictures, MB. Plotly takes 1.5 of it up to version 5.23, and half a megabyte more from 5.24.
MIN_MB = 1.6


def write_report(
    runs: Iterable[Path],
    output: Path,
    *,
    format: str | None = None,
    title: str | None = None,
    tables: Iterable[str] = (),
    columns: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    with_published: bool = True,
    assets: bool = False,
    max_mb: float = 10.0,
    hide_paths: bool = False,
) -> Collection:
    """Read ``runs`` (folders of runs or stores of them) and write the report to ``output``, whole or not at all.

    format: "html", "latex", "csv", "parquet", "markdown" or "json"; None takes it from the suffix. tables: names of
    the tables wanted in an export (all), ``columns`` those of their columns, ``rename`` what to call methods and
    columns; see ``choose``. assets: put full-size pictures into a folder beside the HTML file. max_mb: what
    the HTML file may weigh, in megabytes; its pictures are shrunk to that end. hide_paths: show only the last
    part of absolute paths.
    Raises InputError for unusable input, UsageError for an unknown format or table, OutputError.
    """
    kind = choose_format(output, format)
    if not MIN_MB <= max_mb < math.inf:
        raise UsageError(f"--max-mb {max_mb:g}: a page weighs at least {MIN_MB:g} MB, most of it the plotting library")
    collection = collect(runs)
    if hide_paths:
        collection = privacy.hide_paths(collection)
    published = load_published() if with_published else None
    content: str | bytes
    if kind == "html":
        from panobench.report.html import build_html

        folder = output.with_name(f"{output.stem}_assets") if assets else None
        content = build_html(collection, title=title, published=published, assets=folder, max_bytes=round(max_mb * 1e6))
    else:
        built = build_tables(collection, published)
        chosen = chosen_tables(built, list(tables), columns, rename)
        if kind == "csv" and len(chosen) > 1:
            return _write_csv(collection, chosen, output)
        content = FORMATS[kind](chosen)
    write_whole(output, content)
    return replace(collection, written=(output,))


def _write_csv(collection: Collection, tables: list[Table], output: Path) -> Collection:
    """A file per table: all runs in ``output`` (or the first table there is), the others beside it by their names."""
    main = next((t for t in tables if t.name == "runs"), tables[0])
    written = []
    for table in tables:
        beside = output.with_name(f"{output.stem}.{safe_name(table.name)}{output.suffix}")
        written.append(output if table is main else beside)
        write_whole(written[-1], to_csv([table]))
    return replace(collection, written=(output, *(path for path in written if path != output)))


def safe_name(text: str) -> str:
    """A table's name as part of a file's: names of datasets come from data."""
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in text)[:80]


def choose_format(output: Path, format: str | None) -> str:
    """The format asked for, or the one the suffix of ``output`` stands for."""
    if format is None:
        kind = SUFFIXES.get(output.suffix.lower())
        if kind is None:
            raise UsageError(f"cannot tell the format of '{output}'; name it *.html or give --format")
        return kind
    if format != "html" and format not in FORMATS:
        raise UnknownNameError("report format", format, ["html", *FORMATS])
    return format

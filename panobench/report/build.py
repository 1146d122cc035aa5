"""Write a report file from run folders."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from panobench.bench.paper import load_published
from panobench.errors import UnknownNameError, UsageError
from panobench.report import privacy
from panobench.report.collect import collect
from panobench.report.exports import FORMATS, SUFFIXES
from panobench.report.model import Collection
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
    with_published: bool = True,
    assets: bool = False,
    max_mb: float = 10.0,
    hide_paths: bool = False,
) -> Collection:
    """Read ``runs`` (folders of runs or stores of them) and write the report to ``output``, whole or not at all.

    format: "html", "latex", "csv", "markdown" or "json"; None takes it from the suffix. tables: names of the
    tables wanted in an export (all). assets: put full-size pictures into a folder beside the HTML file. max_mb: what
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
    if kind == "html":
        from panobench.report.html import build_html

        folder = output.with_name(f"{output.stem}_assets") if assets else None
        text = build_html(collection, title=title, published=published, assets=folder, max_bytes=round(max_mb * 1e6))
    else:
        built = build_tables(collection, published)
        wanted = list(tables)
        for name in wanted:
            if name not in [t.name for t in built]:
                raise UnknownNameError("table", name, [t.name for t in built])
        text = FORMATS[kind]([t for t in built if not wanted or t.name in wanted])
    write_whole(output, text)
    return collection


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

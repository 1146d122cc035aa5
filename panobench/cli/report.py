"""`panobench report`: run folders in, one offline HTML file (or tables as LaTeX, CSV, Markdown, JSON) out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer


def report(
    runs: Annotated[
        list[Path], typer.Argument(help="Run folders, or folders that contain them: a suite's store, a study.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")] = Path("report.html"),
    format: Annotated[
        str | None,
        typer.Option("--format", "-f", help="html, latex, csv, markdown or json; by default from the file's suffix."),
    ] = None,
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "",
    table: Annotated[
        list[str] | None,
        typer.Option("--table", help="Only this table, in exports; repeatable (for example ate-rooms, cost, runs)."),
    ] = None,
    published: Annotated[bool, typer.Option(help="Show published figures where they exist for a dataset.")] = True,
    assets: Annotated[
        bool, typer.Option("--assets", help="Also put full-size pictures into a folder beside the page.")
    ] = False,
    max_mb: Annotated[float, typer.Option(help="What the page may weigh, MB; pictures are shrunk to fit.")] = 10.0,
    hide_paths: Annotated[
        bool, typer.Option("--hide-paths", help="Show only the last part of paths: for pages that are published.")
    ] = False,
) -> None:
    """Write a report about finished runs."""
    from panobench.report.build import write_report

    collection = write_report(
        runs,
        output,
        format=format,
        title=title or None,
        tables=table or (),
        with_published=published,
        assets=assets,
        max_mb=max_mb,
        hide_paths=hide_paths,
    )
    for problem in collection.problems:
        print(f"panobench: warning: {problem.folder} is not readable: {problem.message}", file=sys.stderr)
    count = len(collection.runs)
    size = output.stat().st_size
    if output.suffix.lower() in (".html", ".htm") and size > max_mb * 1e6:
        print(
            f"panobench: warning: the page is larger than {max_mb:g} MB even with its smallest pictures",
            file=sys.stderr,
        )
    amount = f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
    studies = len(collection.studies)
    also = f" and {studies} stud{'ies' if studies != 1 else 'y'}" if studies else ""
    print(f"{output}: {count} run{'s' if count != 1 else ''}{also}, {amount}")
    for path in collection.written[1:]:
        print(path)

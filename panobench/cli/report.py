"""`panobench report`: run folders in; one offline HTML file, tables in other formats, or figures out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from panobench.report.model import Collection


def report(
    runs: Annotated[
        list[Path], typer.Argument(help="Run folders, or folders that contain them: a suite's store, a study.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")] = Path("report.html"),
    format: Annotated[
        str | None,
        typer.Option(
            "--format", "-f", help="html, latex, csv, parquet, markdown or json; by default from the file's suffix."
        ),
    ] = None,
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "",
    table: Annotated[
        list[str] | None,
        typer.Option(
            "--table",
            help="Only this table, in exports; repeatable (ate-rooms, cost, runs; ate: one of all datasets).",
        ),
    ] = None,
    columns: Annotated[
        str, typer.Option(help="In exports: only these columns beside the first, in this order: room1,room2,mean.")
    ] = "",
    rename: Annotated[
        list[str] | None,
        typer.Option(metavar="OLD=NEW", help="In exports and figures: another name of a method or column; repeatable."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write figures for a paper there instead of a page.")
    ] = None,
    width: Annotated[str, typer.Option(help="Width of the figures: 3.4in, 86mm, 8.6cm or 245pt.")] = "3.4in",
    figure_format: Annotated[str, typer.Option(help="Of the figures: pdf, svg, pgf, or several: pdf,svg.")] = "pdf,svg",
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
    from panobench.report.choose import parse_names

    names = parse_names(rename or ())
    if figures is not None:
        _write_figures(runs, figures, width, figure_format, names)
        return
    collection = write_report(
        runs,
        output,
        format=format,
        title=title or None,
        tables=table or (),
        columns=[word.strip() for word in columns.split(",") if word.strip()],
        rename=names,
        with_published=published,
        assets=assets,
        max_mb=max_mb,
        hide_paths=hide_paths,
    )
    _warn_of_problems(collection)
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


def _write_figures(runs: list[Path], folder: Path, width: str, formats: str, names: dict[str, str]) -> None:
    from panobench.report.collect import collect
    from panobench.report.paper.style import parse_formats, parse_width
    from panobench.report.paper.write import write_figures

    inches, kinds = parse_width(width), parse_formats(formats)
    collection = collect(runs)
    _warn_of_problems(collection)
    written = write_figures(collection, folder, inches, kinds, names)
    for path in written:
        print(path)
    if not written:
        print("panobench: warning: there is nothing to draw in these runs", file=sys.stderr)


def _warn_of_problems(collection: Collection) -> None:
    for problem in collection.problems:
        print(f"panobench: warning: {problem.folder} is not readable: {problem.message}", file=sys.stderr)

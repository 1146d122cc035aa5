"""`panobench study NAME --out DIR`. The same command again continues.

Exit codes: 0 done (failed runs are rows of the result), 2 bad input or an unwritable folder, 130 interrupted.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer


def study(
    name: Annotated[str, typer.Argument(help="A study, as `panobench list studies` names it.")],
    out: Annotated[Path, typer.Option(help="Folder for its runs and its result, study.json.")],
    quick: Annotated[bool, typer.Option("--quick", help="A small version, under two minutes on two cores.")] = False,
    set: Annotated[
        list[str] | None, typer.Option("--set", help="KEY=VALUE: an option of the study; repeatable.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Runs at the same time; they share the machine's cores.")] = 1,
    retry: Annotated[
        list[str] | None, typer.Option(help="Run again what ended so: failed, or a status; repeatable.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the study's study.json, and nothing else.")] = False,
) -> None:
    """Run a study: one of the paper's tables or figures, or another; `panobench report DIR` shows it."""
    from panobench.bench.records.study_record import STUDY_JSON
    from panobench.bench.run.config import parse_settings
    from panobench.bench.suite.runner import parse_retry
    from panobench.errors import UsageError
    from panobench.plugins import registry
    from panobench.specs import StudySpec
    from panobench.studies.base import StudyRequest
    from panobench.studies.perform import perform

    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: must be at least 1")
    spec = registry().get(StudySpec, name)
    request = StudyRequest(
        out,
        quick=quick,
        options=dict(parse_settings(set or ())),
        jobs=jobs,
        retry=parse_retry(retry or ()),
        say=_quiet if quiet or as_json else _say,
    )
    result = perform(spec, request)
    if as_json:
        print((out / STUDY_JSON).read_text(encoding="utf-8"), end="")
    elif not quiet:
        for table, rows in result.tables.items():
            print(f"{result.captions.get(table, table).split('. ')[0]}\n{_text(rows)}\n")
        print(f"panobench report {out} -o report.html")


def _say(line: str) -> None:
    print(line, file=sys.stderr)


def _quiet(line: str) -> None:
    pass


def _text(rows: list[dict[str, Any]]) -> str:
    from panobench.bench.records.tables import text_table

    header = list(dict.fromkeys(key for row in rows for key in row))
    return text_table(header, [[_cell(row.get(key)) for key in header] for row in rows])


def _cell(value: Any) -> str:
    if value is None:
        return "n/a"
    return f"{value:.3g}" if isinstance(value, float) else str(value)

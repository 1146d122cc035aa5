"""`panobench suite run FILE --out STORE` and `panobench suite status STORE`.

Exit codes: 0 every chosen cell is ok, 1 some ended otherwise, 2 bad input or a store that cannot be written,
130 interrupted. The same command again continues.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(no_args_is_help=True, help="Run a matrix of methods, cameras, datasets and seeds.")


@app.command()
def run(
    file: Annotated[Path, typer.Argument(help="The suite: a YAML file.")],
    out: Annotated[Path, typer.Option(help="The store: where the runs are kept, and found again.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would run and why, and run nothing.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Only cells whose label matches; repeatable.")] = None,
    retry: Annotated[
        list[str] | None, typer.Option(help="Run again what ended so: failed, or a status; repeatable.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Cells run at the same time; they share the machine's cores.")] = 1,
    executor: Annotated[str, typer.Option(help="local or dask.")] = "local",
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask scheduler, tcp://...")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No table.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON when done.")] = False,
) -> None:
    """Run a suite; the same command again continues or amends it."""
    from panobench.bench.suite.file import read_suite
    from panobench.bench.suite.runner import SuiteRunner, choose, make_plan, parse_retry
    from panobench.bench.suite.store import Store
    from panobench.errors import UnknownNameError, UsageError

    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: must be at least 1")
    if executor not in ("local", "dask"):
        raise UnknownNameError("executor", executor, ("local", "dask"))
    if scheduler and executor != "dask":
        raise UsageError("--scheduler is for --executor dask")
    again = parse_retry(retry or ())
    suite = read_suite(file)
    cells = choose(suite.cells, only or ())
    store = Store(out)
    plan = make_plan(cells, store, again, move_damaged=not dry_run)
    moved = "to be moved away" if dry_run else "moved away"
    for note in [*suite.notes, *(f"{q.reason}; {moved}: {q.folder}" for q in plan.quarantined)]:
        typer.echo(f"panobench: warning: {note}", err=True)
    if dry_run:
        print_rows([_row(r.planned.cell.label, r.stored, r.reason) for r in plan.rows], as_json)
        return
    from panobench.cli.suite_table import SuiteTable

    with SuiteTable(suite.name, plan, show=not (quiet or as_json)) as table:
        runner = SuiteRunner(store, suite.name, table)
        if executor == "dask":
            from panobench.bench.suite.distributed import DaskCompute

            with DaskCompute(scheduler, jobs) as compute:
                runner.compute = compute
                runner.run(plan, compute.parallel)
        else:
            runner.run(plan, jobs)
    _conclude(cells, store, as_json, quiet)


def _conclude(cells: list[Any], store: Any, as_json: bool, quiet: bool) -> None:
    from panobench.bench.suite.runner import counts

    rows = [_row(cell.label, store.check(cell)[0], "") for cell in cells]
    if as_json:
        print_rows(rows, True)
    elif not quiet:
        print(", ".join(f"{number} {status}" for status, number in counts(rows).items()) + f"; runs in {store.root}")
    if any(row["status"] != "ok" for row in rows):
        raise typer.Exit(1)


@app.command()
def schema(
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; default: print it.")] = None,
) -> None:
    """JSON Schema of suite files, for editors: keys, methods, data sets, presets and options that there are here."""
    from panobench.bench.suite.model import suite_schema
    from panobench.writing import write_whole

    text = json.dumps(suite_schema(), indent=1, ensure_ascii=False) + "\n"
    if output is None:
        print(text, end="")
    else:
        write_whole(output, text)
        print(output)


@app.command()
def status(
    store: Annotated[Path, typer.Argument(help="A suite's store.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show every result in a store, and what is in its quarantine."""
    from panobench.bench.suite.store import Store

    where = Store(store).require()
    found, damaged = where.runs()
    rows = [_row(s.record.cell.label if s.record.cell else s.folder.name, s, "") for s in found]
    rows += [_row(d.folder.name, None, "") | {"status": "damaged", "message": d.reason} for d in damaged]
    rows += [
        _row(q.folder.name, None, "") | {"status": "quarantined", "message": q.reason} for q in where.quarantined()
    ]
    print_rows(rows, as_json)


def _row(label: str, stored: Any, reason: str) -> dict[str, Any]:
    numbers = ("tracked", "ate_rmse_m", "psnr_db", "fps")
    return {
        "cell": label,
        "status": stored.status if stored else "not run",
        **{name: stored.record.number(name) if stored else None for name in numbers},
        "message": stored.record.message if stored else "",
        "to_do": reason,
        "folder": str(stored.folder) if stored else None,
    }


def print_rows(rows: list[dict[str, Any]], as_json: bool) -> None:
    """Print rows as JSON, as a table on a terminal, or as one line each."""
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    from panobench.cli.table import print_table

    lines = [_cells(row) for row in rows]
    if print_table(("Cell", "Status", "Tracked", "ATE", "Speed", ""), lines, right=(2, 3, 4), status=1):
        return
    width = max((len(line[0]) for line in lines), default=0)
    for cell, status_, tracked, ate, speed, note in lines:
        print(f"{cell:{width}}  {status_:13} {tracked:>5} {ate:>11} {speed:>10}  {note}".rstrip())


def _cells(row: dict[str, Any]) -> list[str]:
    return [
        row["cell"],
        row["status"],
        f"{row['tracked']:.0%}" if isinstance(row["tracked"], float) else "",
        f"{1e3 * row['ate_rmse_m']:.2f} mm" if isinstance(row["ate_rmse_m"], float) else "",
        f"{row['fps']:.1f} fps" if isinstance(row["fps"], float) else "",
        f"to do: {row['to_do']}" if row["to_do"] else row["message"],
    ]

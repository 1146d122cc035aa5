"""`panobench score RUN...`: score stored runs again, under the current protocol or another one, without running."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from panobench.bench.records.record import RunRecord

app = typer.Typer()


@app.command()
def score(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, or folders that contain them.")],
    align: Annotated[str, typer.Option(help="auto (Sim(3)), sim3, se3 or none.")] = "auto",
    min_tracked: Annotated[float, typer.Option(help="Share of frames a run must have tracked.")] = 0.9,
    max_ate: Annotated[float, typer.Option(help="ATE in metres above which a run has failed.")] = 3.0,
    skip: Annotated[float, typer.Option(help="Leave out the first seconds.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="Write the runs with their new scores there.")] = None,
    in_place: Annotated[bool, typer.Option("--in-place", help="Replace the scores in the runs themselves.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Score stored runs again; trajectory numbers and status change, renders and times stay as measured."""
    from panobench.bench.records.compare import run_folders
    from panobench.bench.records.record import read_record, replace_record
    from panobench.bench.records.rescore import ALIGNMENTS, Protocol, rescore, write_copy
    from panobench.errors import UnknownNameError, UsageError

    if out is not None and in_place:
        raise UsageError("--out and --in-place exclude each other")
    if align not in ALIGNMENTS:
        raise UnknownNameError("alignment", align, ALIGNMENTS)
    protocol = Protocol(align, min_tracked, max_ate, skip)  # type: ignore[arg-type]
    folders = [folder for path in runs for folder in run_folders(path)]
    rows = []
    for folder in folders:
        before, after = read_record(folder), rescore(folder, protocol)
        if out is not None:
            write_copy(folder, after, out / folder.name)
        elif in_place:
            replace_record(folder, after)
        rows.append((folder, _short(before), _short(after)))
    if as_json:
        found = [{"run": str(f), "protocol": protocol.name, "before": b, "after": a} for f, b, a in rows]
        print(json.dumps(found, indent=2))
        return
    from panobench.bench.records.tables import text_table
    from panobench.cli.table import print_table

    header = ["run", "status", "ATE mm", "RPE mm", "tracked"]
    lines = [[folder.name, *_pairs(before, after)] for folder, before, after in rows]
    print(f"protocol {protocol.name}")
    if not print_table(header, lines, right=(2, 3, 4)):
        print(text_table(header, lines))


def _short(record: RunRecord) -> dict[str, Any]:
    names = ("ate_rmse_m", "ate_keyframes_rmse_m", "rpe_trans_rmse_m", "tracked")
    return {"status": record.status, **{name: record.number(name) for name in names}}


def _pairs(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Each value as "old -> new", or alone where it stays."""
    words = []
    for key, form, factor in (
        ("status", "{}", None),
        ("ate_rmse_m", "{:.3f}", 1e3),
        ("rpe_trans_rmse_m", "{:.3f}", 1e3),
        ("tracked", "{:.1%}", 1.0),
    ):
        old, new = (
            "n/a" if d[key] is None else form.format(d[key] if factor is None else d[key] * factor)
            for d in (before, after)
        )
        words.append(new if old == new else f"{old} -> {new}")
    return words

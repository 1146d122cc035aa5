"""`panobench import`: score a trajectory made elsewhere, with renders if there are any, as a run marked imported.

Exit codes: 0 scored, 1 scored and judged lost, 2 bad input and nothing written.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from panobench.bench.request import RunRequest, run_options
from panobench.cli.run_options import with_run_options

if TYPE_CHECKING:
    from panobench.bench.record import RunRecord
    from panobench.external.imported import ImportOptions

app = typer.Typer()


@app.command(name="import")
@with_run_options([o for o in run_options() if o.changes_input or o.import_help], lambda o: o.import_help or o.help)
def import_run(
    given: dict[str, Any],
    trajectory: Annotated[Path, typer.Argument(help="The trajectory: TUM, KITTI or EuRoC.")],
    name: Annotated[str, typer.Option(help="What the row is called: the method, as it is to stand in tables.")],
    form: Annotated[
        str | None, typer.Option("--format", help="tum, tum-ns, kitti, euroc or csv; default: look.")
    ] = None,
    inverse: Annotated[bool, typer.Option("--inverse", help="The file holds world-to-camera poses.")] = False,
    time_unit: Annotated[str | None, typer.Option(help="What its times count: s, ms, us or ns; default: look.")] = None,
    time_offset: Annotated[float, typer.Option(help="Seconds added to the trajectory's times.")] = 0.0,
    max_dt: Annotated[float | None, typer.Option(help="Seconds a pose may be away from its frame.")] = None,
    metric: Annotated[bool, typer.Option("--metric", help="Its scale is metres: add the error without scale.")] = False,
    renders: Annotated[Path | None, typer.Option(help="Folder with a render of each frame that has a pose.")] = None,
    citation: Annotated[str, typer.Option(help="Where the method is published.")] = "",
    out: Annotated[Path | None, typer.Option(help="The run folder; default: a new one below runs/.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No summary.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the run's run.json, and nothing else.")] = False,
) -> None:
    """Score a trajectory made elsewhere; the row is marked imported."""
    from panobench.bench.record import read_record
    from panobench.bench.runfolder import RUN_JSON
    from panobench.cli.run import exit_code, summary
    from panobench.errors import UsageError
    from panobench.external.imported import ImportOptions

    if not name.strip() or not name.isprintable() or len(name) > 80:
        raise UsageError("--name: give one line of up to 80 characters")
    request = RunRequest(method=name, **given)
    options = ImportOptions(form, inverse, time_offset, max_dt, metric, renders, time_unit)  # type: ignore[arg-type]
    folder = score_import(trajectory, request, options, out, force=force, citation=citation)
    record = read_record(folder)
    if as_json:
        print((folder / RUN_JSON).read_text(encoding="utf-8"), end="")
    elif not quiet:
        print(f"imported: {summary(folder, record)}")
    code = exit_code(record.status)
    if code:
        typer.echo(f"panobench: {record.status}: {record.message}", err=True)
        raise typer.Exit(code)


def score_import(
    trajectory: Path,
    request: RunRequest,
    options: ImportOptions,
    out: Path | None = None,
    *,
    force: bool = False,
    citation: str = "",
) -> Path:
    """Write a run folder for a trajectory file and return it. ``request.method`` is the row's name.

    Raises PanobenchError for a trajectory, renders or a sequence that cannot be used; nothing is written then.
    """
    from panobench.bench.evaluate import evaluate
    from panobench.bench.observer import Observer
    from panobench.bench.provenance import provenance
    from panobench.bench.record import TimingRecord
    from panobench.bench.results import run_record, write_run
    from panobench.bench.runfolder import LOG, RENDERS, PendingRun, check_free
    from panobench.bench.runner import RunLog, default_folder
    from panobench.bench.setup import RunSetup, open_input
    from panobench.bench.tracking import track_batch
    from panobench.bench.views import held_out
    from panobench.external.imported import ImportedTrajectory
    from panobench.methods.base import MethodContext
    from panobench.metrics.base import MetricInput
    from panobench.specs import MethodSpec
    from panobench.writing import TEXT

    target = out or default_folder(request)
    check_free(target, force)
    sequence = open_input(request)
    holdout = held_out(len(sequence), request.holdout)
    method = ImportedTrajectory(trajectory, options)
    spec = MethodSpec(request.method, "imported", "", cameras=(sequence.camera.kind,), citation=citation)
    setup = RunSetup(spec, "imported", method, None, sequence, None)
    tracked = track_batch(method, sequence, frozenset(holdout), MethodContext(), Observer())
    assert tracked.estimate is not None
    tracked.latency, tracked.wall_s = [], 0.0
    with PendingRun(target, force) as pending:
        with (pending.path / LOG).open("w", **TEXT) as file:
            log = RunLog(file)
            log(f"{len(tracked.estimate.trajectory)} poses of {trajectory} belong to {len(sequence)} frames")
            data = MetricInput(
                sequence,
                tracked.estimate,
                frames=list(range(len(sequence))),
                holdout=holdout,
                render=method.render if options.renders else None,
                renders=pending.path / RENDERS if options.renders else None,
            )
            scores = evaluate(data, tracked.status, tracked.message, log)
            timing = TimingRecord(evaluation_s=scores.evaluation_s)  # nothing else was timed here
            record = run_record(request, setup, tracked, holdout, scores, timing, provenance())
            _mark(record, trajectory, options)
            write_run(pending.path, record, setup, tracked, holdout)
        return pending.publish()


def _mark(record: RunRecord, trajectory: Path, options: ImportOptions) -> None:
    """Say where the trajectory came from."""
    import hashlib

    from panobench.bench.record import ImportedRecord

    record.origin = "imported"
    record.imported = ImportedRecord(
        trajectory=trajectory.name,
        sha256=hashlib.sha256(trajectory.read_bytes()).hexdigest(),
        format=options.form,
        inverse=options.inverse,
        time_offset_s=options.time_offset,
        renders=None if options.renders is None else options.renders.name,
    )
    record.provenance.command = shlex.join(["panobench", *sys.argv[1:]])

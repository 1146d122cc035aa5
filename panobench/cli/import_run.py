"""`panobench import`: score a trajectory made elsewhere, with renders if there are any, as a run marked imported.

Exit codes: 0 scored, 1 scored and judged lost, 2 bad input and nothing written.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from panobench.bench.run.request import DEFAULT_DATASET, RunRequest, run_options
from panobench.cli.run_options import with_run_options

if TYPE_CHECKING:
    from panobench.bench.records.record import RunRecord
    from panobench.bench.run.views import ChosenFrames
    from panobench.external.imported import ImportedTrajectory, ImportOptions
    from panobench.trajectories.matching import Placed

app = typer.Typer()


@app.command(name="import")
@with_run_options([o for o in run_options() if o.changes_input or o.import_help], lambda o: o.import_help or o.help)
def import_run(
    given: dict[str, Any],
    trajectory: Annotated[
        Path,
        typer.Argument(help="The trajectory: TUM, KITTI, 4x4 rows, CSV, COLMAP's images, transforms.json, ..."),
    ],
    name: Annotated[
        str | None, typer.Option(help="What the row is called, as it is to stand in tables; default: the file's name.")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="Another trajectory to judge it by; with --root or --dataset at the frames of that data."),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="tum, tum-ns, kitti, matrices, euroc, csv, colmap, transforms or monogs; default: look.",
        ),
    ] = None,
    inverse: Annotated[bool, typer.Option("--inverse", help="The file holds world-to-camera poses.")] = False,
    time_unit: Annotated[
        str | None, typer.Option(help="What its times count: s, ms, us, ns or frames; default: look.")
    ] = None,
    keyframes: Annotated[
        bool, typer.Option("--keyframes", help="It has the poses of keyframes alone: judge these.")
    ] = False,
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
    from panobench.bench.records.record import read_record
    from panobench.bench.records.runfolder import RUN_JSON
    from panobench.cli.run import exit_code, summary
    from panobench.errors import UsageError
    from panobench.external.imported import ImportOptions

    name = trajectory.stem if name is None else name
    if not name.strip() or not name.isprintable() or len(name) > 80:
        raise UsageError("--name: give one line of up to 80 characters")
    if against is not None and given["groundtruth"] is not None:
        raise UsageError("--against and --groundtruth both name the trajectory to judge by; give one")
    named = given["root"] or given["sequence"] or given["dataset"] != DEFAULT_DATASET
    if against is not None and named:
        given["groundtruth"], against = str(against), None
    request = RunRequest(method=name, **given)
    options = ImportOptions(form, inverse, time_offset, max_dt, metric, renders, time_unit, keyframes)
    folder = score_import(trajectory, request, options, out, force=force, citation=citation, against=against)
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
    against: Path | None = None,
) -> Path:
    """Write a run folder for a trajectory file and return it. ``request.method`` is the row's name.

    ``against``: another trajectory to judge it by, without a data set.

    Raises PanobenchError for a trajectory, renders or a sequence that cannot be used; nothing is written then.
    """
    from panobench.bench.records.provenance import provenance
    from panobench.bench.records.record import TimingRecord
    from panobench.bench.records.results import run_record, write_run
    from panobench.bench.records.runfolder import LOG, RENDERS, PendingRun, check_free
    from panobench.bench.run.evaluate import evaluate
    from panobench.bench.run.observer import Observer
    from panobench.bench.run.runner import RunLog, default_folder
    from panobench.bench.run.setup import RunSetup, open_input
    from panobench.bench.run.tracking import track_batch
    from panobench.bench.run.truth import align_clocks
    from panobench.bench.run.views import held_out
    from panobench.external.imported import ImportedTrajectory
    from panobench.methods.base import MethodContext
    from panobench.metrics.base import MetricInput
    from panobench.specs import MethodSpec
    from panobench.trajectories.matching import Frames
    from panobench.writing import TEXT

    target = out or default_folder(request)
    check_free(target, force)
    method = ImportedTrajectory(trajectory, options)
    if against is None:
        request, _ = request.resolved()
        sequence = open_input(request)
        method.frames = Frames.of(sequence)
    else:
        request, sequence = _path_alone(request, method, against)
    holdout = held_out(len(sequence), request.holdout)
    spec = MethodSpec(request.method, "imported", "", cameras=(sequence.camera.kind,), citation=citation)
    setup = RunSetup(spec, "imported", method, None, sequence, None)
    tracked = track_batch(method, sequence, frozenset(holdout), MethodContext(), Observer())
    assert tracked.estimate is not None
    assert method.placed is not None
    placed = method.placed
    tracked.latency, tracked.wall_s = [], 0.0
    with PendingRun(target, force) as pending:
        with (pending.path / LOG).open("w", **TEXT) as file:
            log = RunLog(file)
            log(f"{trajectory}: {placed.counts()}; {len(placed.index)} of {len(sequence)} frames have one")
            offset = None
            if request.align_time:
                setup, offset = align_clocks(setup, tracked, log)
            data = MetricInput(
                setup.sequence,
                tracked.estimate,
                frames=list(range(len(sequence))),
                holdout=holdout,
                render=method.render if options.renders else None,
                renders=pending.path / RENDERS if options.renders else None,
                keyframes_only=options.keyframes,
            )
            scores = evaluate(data, tracked.status, tracked.message, log)
            timing = TimingRecord(evaluation_s=scores.evaluation_s)  # nothing else was timed here
            record = run_record(request, setup, tracked, holdout, scores, timing, provenance(), offset)
            _mark(record, trajectory, options, placed)
            write_run(pending.path, record, setup, tracked, holdout)
        return pending.publish()


def _path_alone(request: RunRequest, method: ImportedTrajectory, against: Path) -> tuple[RunRequest, ChosenFrames]:
    """Two trajectories without a data set: the frames are the poses of the other, as the run's data set "path"."""
    from panobench.bench.run.views import ChosenFrames
    from panobench.cameras.erp import ErpCamera
    from panobench.external.imported import read_imported
    from panobench.trajectories.reading import read_poses
    from panobench.trajectories.reference import PathAlone, scaled_as

    method.poses = read_imported(method.path, method.options)
    reference = read_poses(against)
    scaled = scaled_as(request.groundtruth_scale, reference)
    frames = PathAlone(
        against, reference, method.poses, ErpCamera(request.width or 512, (request.width or 512) // 2), scaled
    )
    method.frames = frames.frames_to_match()
    changed = replace(request, dataset=frames.dataset, sequence=frames.name, groundtruth=str(against))
    return changed, ChosenFrames(frames)


def _mark(record: RunRecord, trajectory: Path, options: ImportOptions, placed: Placed) -> None:
    """Say where the trajectory came from, and how many of its poses were of use."""
    from panobench.bench.records.record import ImportedRecord
    from panobench.datasets.files.checksums import known_sha256

    record.origin = "imported"
    record.imported = ImportedRecord(
        trajectory=trajectory.name,
        sha256=known_sha256(trajectory) if trajectory.is_file() else "",
        format=options.form,
        inverse=options.inverse,
        time_offset_s=options.time_offset,
        poses=placed.poses,
        unplaced=placed.unplaced,
        keyframes=options.keyframes,
        renders=None if options.renders is None else options.renders.name,
    )
    record.remarks = [*record.remarks, *placed.remarks]
    if record.status == "lost" and not options.keyframes and not placed.unplaced:
        record.message += "; if the file has keyframes alone, add --keyframes"
    record.provenance.command = shlex.join(["panobench", *sys.argv[1:]])

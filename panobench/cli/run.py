"""`panobench run`: one method on one sequence, stored as a run folder.

Exit codes: 0 ok, 1 the run ended otherwise (lost, crashed, ...), 2 bad input and nothing written, 3 with --strict where
the verdict is not "trusted", 130 interrupted.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from panobench.bench.run.request import RunRequest, run_options
from panobench.cli.run_options import with_run_options
from panobench.errors import UsageError

if TYPE_CHECKING:
    from panobench.bench.records.record import FramesRecord, MaskRecord, RunRecord, VerdictRecord

app = typer.Typer()
EXIT_NOT_OK, EXIT_NOT_TRUSTED, EXIT_INTERRUPTED = 1, 3, 130


def watching(option: str | None) -> AbstractContextManager[object]:
    """The viewer of ``--viewer``, attached to the lifecycle hooks while the context lasts."""
    if option is None:
        return nullcontext()
    from panobench.viewer.choose import viewer

    return viewer(option)


@app.command()
@with_run_options(run_options(), lambda option: option.help)
def run(
    given: dict[str, Any],
    out: Annotated[Path | None, typer.Option(help="The run folder; default: a new one below runs/.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with code 3 unless the verdict on the run is: trusted.")
    ] = False,
    viewer: Annotated[
        str | None,
        typer.Option(help="Watch the run: rerun opens a window, rerun:FILE.rrd writes a file, web serves a page."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the run's log as it is written.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the run's run.json, and nothing else.")] = False,
) -> None:
    """Run one method on one sequence and store the run."""
    request = RunRequest(**given)
    if quiet and verbose:
        raise UsageError("--quiet and --verbose exclude each other")
    with watching(viewer):
        folder = run_with_progress(request, out, force, show=verbose or not (quiet or as_json), verbose=verbose)
    from panobench.bench.records.record import read_record
    from panobench.bench.records.runfolder import RUN_JSON

    record = read_record(folder)
    if as_json:
        print((folder / RUN_JSON).read_text(encoding="utf-8"), end="")
    elif not quiet:
        print(summary(folder, record))
    code = exit_code(record.status)
    if code:
        typer.echo(f"panobench: {record.status}: {record.message} (see {folder / 'log.txt'})", err=True)
        raise typer.Exit(code)
    if strict and record.verdict is not None and record.verdict.word != "trusted":
        reason = record.verdict.reasons[0] if record.verdict.reasons else ""
        typer.echo(f"panobench: the run is {record.verdict.word}: {reason}", err=True)
        raise typer.Exit(EXIT_NOT_TRUSTED)


def run_with_progress(request: RunRequest, out: Path | None, force: bool, show: bool, verbose: bool = False) -> Path:
    """Execute the request with a progress bar on standard error, if it is a terminal, and the log if ``verbose``."""
    from panobench.bench.run.runner import execute

    if not show:
        return execute(request, out, force=force)
    from panobench.cli.progress import ProgressBar

    with ProgressBar(f"{request.method} on {request.sequence or request.dataset}", verbose=verbose) as bar:
        return execute(request, out, force=force, observer=bar)


def exit_code(status: str) -> int:
    """The exit code of a run's status."""
    return {"ok": 0, "interrupted": EXIT_INTERRUPTED}.get(status, EXIT_NOT_OK)


#: Lines of the summary: label, name of the number, factor, format.
_LINES = (
    ("ATE", "ate_rmse_m", 1e3, "{:.2f} mm"),
    ("ATE without scale", "ate_se3_rmse_m", 1e3, "{:.2f} mm"),
    ("  scale error", "scale_error_percent", 1.0, "{:.3f} %"),
    ("gravity error", "gravity_error_deg", 1.0, "{:.3f} deg"),
    ("challenge score", "challenge_score", 1.0, "{:.2f} of 100"),
    ("ATE of keyframes", "ate_keyframes_rmse_m", 1e3, "{:.2f} mm"),
    ("ATE / path", "ate_percent", 1.0, "{:.3f} %"),
    ("RPE", "rpe_trans_rmse_m", 1e3, "{:.2f} mm"),
    ("three views", "psnr_db", 1.0, "{:.2f} dB"),
    ("  SSIM", "ssim", 1.0, "{:.4f}"),
    ("panorama", "pano_psnr_db", 1.0, "{:.2f} dB"),
    ("  held out", "holdout_psnr_db", 1.0, "{:.2f} dB"),
    ("  novel views", "novel_psnr_db", 1.0, "{:.2f} dB"),
    ("whole system", "fps", 1.0, "{:.2f} frames/s"),
    ("tracking alone", "tracking_fps", 1.0, "{:.2f} frames/s"),
    ("peak memory", "peak_rss_bytes", 2.0**-20, "{:.0f} MiB"),
)


def verdict_lines(verdict: VerdictRecord) -> list[str]:
    """The verdict, why it is not better, and what to do."""
    lines = [f"{'verdict':18}{verdict.word} ({verdict.confidence:.2f})"]
    if verdict.word != "trusted":
        lines += [f"  because {reason}" for reason in verdict.reasons]
        lines += [f"  try: {advice}" for advice in verdict.advice]
    return lines


def tracked_text(frames: FramesRecord) -> str:
    """How many frames have a pose, of how many; with those planned where the run ended before them."""
    planned = f"{frames.planned} planned" if frames.planned else "the frames"
    if frames.given == 0:
        return f"none of {planned}: it ended before the first was done"
    left = f", {planned}" if frames.planned and frames.planned > frames.given else ""
    return f"{frames.tracked} of {frames.given} frames{left}"


def mask_source(mask: MaskRecord) -> str:
    """Where a mask came from: "geometry", "camera", "mask.png", "geometry and camera"."""
    given = mask.hidden > mask.found + 1e-6
    own = mask.source == "file"
    found = ((mask.file if own else "") or mask.source) if mask.found else ""
    return " and ".join(part for part in (found, ((not own and mask.file) or "camera") if given else "") if part)


def summary(folder: Path, record: RunRecord) -> str:
    """The most important numbers in a few lines, with what to know before comparing them; run.json has everything."""
    from panobench.bench.records.cautions import CAUTIONS, cautions

    frames = record.frames
    lines = [f"{record.status}  {folder}", f"{'tracked':18}{tracked_text(frames)}"]
    if record.truth is not None:
        lines.append(f"{'ground truth':18}{record.truth.frames} of {frames.planned or frames.given} frames")
    for label, key, factor, form in _LINES:
        value = record.number(key)
        if value is not None:
            lines.append(f"{label:18}{form.format(value * factor)}")
    mask = record.mask
    if mask is not None and (mask.hidden or mask.frames):
        more = f" in all frames, more in {mask.frames} of them" if mask.frames else ""
        lines.append(f"{'mask':18}{mask.hidden:.1%} of the view hidden{more} ({mask_source(mask)})")
    told = [word for word in cautions(record) if word != "doubtful"]  # the verdict's lines say that one
    lines += [f"{word}: {CAUTIONS[word].replace('’', chr(39))}" for word in told]
    lines += [f"note: {remark}" for remark in (*record.remarks, record.notes.get("ate_rotation_rmse_deg")) if remark]
    if record.verdict is not None:
        lines += verdict_lines(record.verdict)
    return "\n".join(lines)

"""`panobench run`: one method on one sequence, stored as a run folder.

Exit codes: 0 ok, 1 the run ended otherwise (lost, crashed, ...), 2 bad input and nothing written, 130 interrupted.
"""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from panobench.bench.config import parse_settings
from panobench.bench.request import RunRequest
from panobench.errors import UsageError

app = typer.Typer()
EXIT_NOT_OK, EXIT_INTERRUPTED = 1, 130


def watching(option: str | None) -> AbstractContextManager[object]:
    """The viewer of ``--viewer``, attached to the lifecycle hooks while the context lasts."""
    if option is None:
        return nullcontext()
    from panobench.viewer.choose import viewer

    return viewer(option)


@app.command()
def run(
    method: Annotated[str, typer.Option(help="Method; see `panobench list methods`.")] = "panogs",
    camera: Annotated[str, typer.Option(help="MODEL, MODEL:VIEW (pinhole:front) or a calibration file.")] = "erp",
    dataset: Annotated[str, typer.Option(help="Dataset; see `panobench list datasets`.")] = "rooms",
    sequence: Annotated[str | None, typer.Option(help="Sequence; default: the first.")] = None,
    root: Annotated[str | None, typer.Option(help="Folder or file of the data.")] = None,
    width: Annotated[int, typer.Option(help="Width of the images given to the method, pixels.")] = 512,
    fov: Annotated[str | None, typer.Option(help="Field of view in degrees: 120 or 120x60.")] = None,
    depth: Annotated[str | None, typer.Option(help="First depth: NAME or NAME:ARGUMENT; default: bootstrap.")] = None,
    every: Annotated[int, typer.Option(help="Use each n-th frame.")] = 1,
    max_frames: Annotated[int | None, typer.Option(help="Use at most this many frames.")] = None,
    holdout: Annotated[int, typer.Option(help="Track but never map each n-th frame; 0: none.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of all randomness.")] = 0,
    preset: Annotated[str | None, typer.Option(help="Preset of the method's options.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One option of the method; repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The run folder; default: a new one below runs/.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out.")] = False,
    viewer: Annotated[
        str | None, typer.Option(help="Watch the run: rerun opens a window, rerun:FILE.rrd writes a file.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the run's log as it is written.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the run's run.json, and nothing else.")] = False,
) -> None:
    """Run one method on one sequence and store the run."""
    request = RunRequest(
        method=method,
        camera=camera,
        dataset=dataset,
        sequence=sequence,
        root=root,
        width=width,
        fov=fov,
        depth=depth,
        every=every,
        max_frames=max_frames,
        holdout=holdout,
        seed=seed,
        preset=preset,
        settings=parse_settings(settings or ()),
    )
    if quiet and verbose:
        raise UsageError("--quiet and --verbose exclude each other")
    with watching(viewer):
        folder = run_with_progress(request, out, force, show=verbose or not (quiet or as_json), verbose=verbose)
    from panobench.bench.runfolder import RUN_JSON, read_run_json

    document = read_run_json(folder)
    if as_json:
        print((folder / RUN_JSON).read_text(encoding="utf-8"), end="")
    elif not quiet:
        print(summary(folder, document))
    code = exit_code(document["status"])
    if code:
        typer.echo(f"panobench: {document['status']}: {document['message']} (see {folder / 'log.txt'})", err=True)
        raise typer.Exit(code)


def run_with_progress(request: RunRequest, out: Path | None, force: bool, show: bool, verbose: bool = False) -> Path:
    """Execute, with a progress bar on a terminal's standard error, and the log if ``verbose``."""
    from panobench.bench.runner import execute

    if not show:
        return execute(request, out, force=force)
    from panobench.cli.progress import ProgressBar

    with ProgressBar(f"{request.method} on {request.sequence or request.dataset}", verbose=verbose) as bar:
        return execute(request, out, force=force, observer=bar)


def exit_code(status: str) -> int:
    """The exit code of a run's status."""
    return {"ok": 0, "interrupted": EXIT_INTERRUPTED}.get(status, EXIT_NOT_OK)


#: Lines of the summary: label, key, factor, format.
_LINES = (
    ("ATE", "ate_rmse_m", 1e3, "{:.2f} mm"),
    ("ATE of keyframes", "ate_keyframes_rmse_m", 1e3, "{:.2f} mm"),
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


def summary(folder: Path, document: dict[str, Any]) -> str:
    """A few lines for people; run.json has everything."""
    numbers = {**document["metrics"], **document["timing"]}
    frames = document["frames"]
    lines = [f"{document['status']}  {folder}", f"{'tracked':18}{frames['tracked']} of {frames['given']} frames"]
    for label, key, factor, form in _LINES:
        value = numbers.get(key)
        if value is not None:
            lines.append(f"{label:18}{form.format(value * factor)}")
    if document["depth"]["oracle"]:
        lines.append("note: the dataset's own depth was given to the method (oracle)")
    return "\n".join(lines)


def to_json(document: dict[str, Any]) -> str:
    """As printed by --json options."""
    return json.dumps(document, indent=2)

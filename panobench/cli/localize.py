"""`panobench localize`: where the frames of a recording were taken in a saved map.

Exit codes: 0 at least one frame was found, 1 none was, 2 bad input and nothing written, 130 interrupted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from panobench.bench.run.request import DEFAULT_DATASET, RunRequest
from panobench.cli.run import EXIT_INTERRUPTED, run_with_progress


def localize(
    source: Annotated[Path, typer.Argument(help="A video, a folder of images, or a dataset's folder.")],
    saved: Annotated[Path, typer.Option("--map", help="The saved map: what `panobench run --save-map` wrote.")],
    dataset: Annotated[str, typer.Option(help="Dataset adapter; default: guessed.")] = DEFAULT_DATASET,
    sequence: Annotated[str | None, typer.Option(help="Sequence; default: the first.")] = None,
    camera: Annotated[str, typer.Option(help="MODEL, MODEL:VIEW or a calibration file.")] = "erp",
    width: Annotated[int, typer.Option(help="Width of the images in pixels.")] = 512,
    every: Annotated[int, typer.Option(help="Use each n-th frame.")] = 1,
    max_frames: Annotated[int | None, typer.Option(help="Use at most this many frames.")] = None,
    mask: Annotated[str | None, typer.Option(help="What hides part of the view: auto, none or an image file.")] = None,
    out: Annotated[Path | None, typer.Option(help="The run folder; default: a new one below runs/.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the run that is in --out.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the run's run.json, and nothing else.")] = False,
) -> None:
    """Find the camera in a saved map; poses are in the map's frame, and frames that are not in it have none."""
    from panobench.bench.records.record import read_record
    from panobench.bench.records.runfolder import RUN_JSON, TRAJECTORY

    request = RunRequest(
        method="localise", root=str(source), dataset=dataset, sequence=sequence, camera=camera, width=width,
        every=every, max_frames=max_frames, mask=mask, check="none", continue_map=str(saved),
    )  # fmt: skip
    folder = run_with_progress(request, out, force, show=not (quiet or as_json))
    record = read_record(folder)
    if as_json:
        print((folder / RUN_JSON).read_text(encoding="utf-8"), end="")
    elif not quiet:
        print(f"{record.frames.tracked} of {record.frames.given} frames are in the map: {folder / TRAJECTORY}")
    if record.status == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if record.frames.tracked == 0:
        raise typer.Exit(1)

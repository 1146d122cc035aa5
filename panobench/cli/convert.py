"""`panobench convert`: any sequence seen by another camera, written in panobench's format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from panobench.cli.given_options import (
    CalibrationOption,
    ImuTopicOption,
    LayoutOption,
    RateOption,
    TopicOption,
    TruthTopicOption,
)
from panobench.errors import UsageError

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.datasets.base import FrameSequence
    from panobench.datasets.writing.export import Exporter, Target

app = typer.Typer()


@app.command()
def convert(
    dataset: Annotated[str, typer.Argument(help="Dataset to read; see `panobench list datasets`.")],
    to: Annotated[
        str, typer.Option("--to", help="Target camera: erp, pal, pinhole, cubemap, fisheye, or a calibration file.")
    ],
    root: Annotated[Path | None, typer.Option(help="Where the dataset is; default $PANOBENCH_DATA/DATASET.")] = None,
    sequence: Annotated[list[str] | None, typer.Option(help="Sequence; may be repeated. Default: all.")] = None,
    rate: RateOption = None,
    calibration: CalibrationOption = None,
    topic: TopicOption = None,
    imu_topic: ImuTopicOption = None,
    groundtruth_topic: TruthTopicOption = None,
    layout: LayoutOption = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the sequences; default DATASET-CAMERA here.")] = None,
    width: Annotated[int | None, typer.Option(help="Width in pixels; default keeps the resolution.")] = None,
    views: Annotated[
        str | None,
        typer.Option(help="Views for pinhole and fisheye: front,left,right,back,up,down. Pinhole: front,left,right."),
    ] = None,
    fov: Annotated[str | None, typer.Option(help="Field of view in degrees, 120 or 120x60.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every N-th frame.")] = 1,
    workers: Annotated[int | None, typer.Option(min=1, max=64, help="Threads; default: the CPU's cores.")] = None,
    image_format: Annotated[str, typer.Option("--format", help="png (exact) or jpg (quality 95).")] = "png",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be written, and write nothing.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Convert a dataset to another camera.

    Writes one panobench sequence per sequence and view: images, camera file, mask of what the source saw,
    radial depth, ground truth moved into the target camera's frame, and the IMU. Generated sequences are
    rendered by the target camera. An interrupted conversion continues when the same command is run again.
    """
    from panobench.datasets.given import Given
    from panobench.datasets.open import open_dataset
    from panobench.datasets.writing.export import ExportOptions, check_writable
    from panobench.datasets.writing.writer import FORMATS

    if image_format not in FORMATS:
        raise UsageError(f"--format {image_format}: choose one of {', '.join(FORMATS)}")
    _check_views(to, views)
    given = Given(rate, calibration, topic, imu_topic, groundtruth_topic, layout)
    source = open_dataset(dataset, root, given)
    names = list(sequence) if sequence else source.sequences()
    folder = out or Path(f"{dataset}-{Path(to).stem.replace(':', '-')}")
    check_writable(folder)
    options = ExportOptions(every, image_format, workers or _cores())
    for name in names:
        opened = source.open(name)
        for remark in opened.remarks():
            typer.echo(f"{opened.name}: {remark}", err=True)
        for seen, targets in _sources(opened, _targets(opened, to, views, folder, width, fov)):
            _convert_one(seen, targets, options, dry_run, quiet)


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_VIEWED = {"pinhole": ("front", "left", "right"), "fisheye": ("front",)}


def _check_views(to: str, views: str | None) -> None:
    if views is not None and to not in _VIEWED:
        raise UsageError(f"--views goes with --to {' or '.join(_VIEWED)}, not with '{to}'")
    if views is not None and not _view_names(views):
        raise UsageError("--views is empty: name for example front,left,right")


def _view_names(views: str) -> list[str]:
    return list(dict.fromkeys(v.strip() for v in views.split(",") if v.strip()))


def _targets(
    opened: FrameSequence, to: str, views: str | None, folder: Path, width: int | None, fov: str | None
) -> list[Target]:
    """One target per view; the sequence's folder is named after the sequence and the view."""
    from panobench.cameras.factory import parse_camera_option
    from panobench.datasets.writing.export import Target

    name = opened.name.replace("/", "-")
    chosen = _view_names(views) if views else _VIEWED.get(to, ())
    if not chosen:
        return [Target(folder / name, parse_camera_option(to, opened.camera, width, fov))]
    return [
        Target(folder / f"{name}-{view}", parse_camera_option(f"{to}:{view}", opened.camera, width, fov))
        for view in chosen
    ]


def _sources(opened: FrameSequence, targets: list[Target]) -> list[tuple[FrameSequence, list[Target]]]:
    """What each target is made of: a generator renders for every target, a recording is reprojected to all of them.

    A recording that would be enlarged is warned of.
    """
    import numpy as np

    from panobench.cameras.factory import CameraChoice
    from panobench.cameras.footprint import enlarged_remark, enlargement
    from panobench.datasets.writing.export import Target

    rendered = []
    for target in targets:
        choice = target.choice
        made = opened.rendered_by(choice.camera, choice.R_target_source)
        if made is not None:
            rendered.append((made, [Target(target.path, CameraChoice(made.camera, np.eye(3), choice.label))]))
            continue
        factor = enlargement(opened.camera, choice.camera, choice.R_target_source)
        for remark in enlarged_remark(factor, choice.camera, opened.camera):
            typer.echo(f"{target.path}: {remark}", err=True)
    return rendered or [(opened, targets)]


def _convert_one(opened: FrameSequence, targets: list[Target], options: object, dry_run: bool, quiet: bool) -> None:
    from rich.console import Console

    from panobench.datasets.writing.export import Exporter, ExportOptions, free_bytes

    assert isinstance(options, ExportOptions)
    exporter = Exporter(opened, targets, options)
    console = Console(highlight=False, soft_wrap=True)
    if dry_run:
        for k, target in enumerate(exporter.targets):
            if exporter.finished[k]:
                console.print(f"{target.path}: finished already; its checksums are right")
                continue
            console.print(
                f"{target.path}: {len(exporter.indices)} frames, {describe(exporter.camera(k))}, {_parts(exporter)}, "
                f"about {exporter.estimate_bytes(k) / 1e6:.1f} MB"
            )
        console.print(f"free space: {free_bytes(exporter.targets[0].path) / 1e6:.0f} MB; nothing was written")
        return
    _write(exporter, opened.name, quiet)
    for k, target in enumerate(exporter.targets):
        if exporter.finished[k]:
            console.print(f"{target.path}: was finished already; its checksums are right")
        else:
            console.print(f"{target.path}: {len(exporter.indices)} frames, {describe(exporter.camera(k))}")


def _write(exporter: Exporter, name: str, quiet: bool) -> None:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    total = len(exporter.indices) * len(exporter.targets)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(name, total=total)
        try:
            exporter.write(lambda n: bar.advance(task, n))
        except KeyboardInterrupt:
            bar.console.print("interrupted; the same command continues from here")
            raise


def describe(camera: Camera) -> str:
    """A camera in a few words."""
    seen = camera.valid_mask().mean()
    part = "" if seen > 0.999 else f", {100 * seen:.0f}% of the pixels valid"
    return f"{camera.kind} {camera.width}x{camera.height}{part}"


def _parts(exporter: Exporter) -> str:
    s = exporter.sequence
    parts = ["images"]
    parts += ["depth"] if s.depth(0) is not None else []
    parts += ["ground truth"] if s.groundtruth is not None else []
    parts += ["IMU"] if s.imu is not None else []
    return " + ".join(parts)

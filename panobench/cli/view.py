"""`panobench view`: a contact sheet of an image or sequence through any camera, and a page to look around in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from panobench.cli.given_options import LayoutOption, TopicOption
from panobench.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from panobench.bench.records.map_views import MapSequence
    from panobench.cameras.factory import CameraChoice
    from panobench.datasets.base import FrameSequence
    from panobench.datasets.inspection.contact_sheet import Cell

app = typer.Typer()

#: Wider panoramas are reduced for the page, because browsers refuse them.
_PAGE_WIDTH = 4096
#: A camera that sees less of the sphere gets no page.
_PAGE_COVERAGE = 0.3


@app.command()
def view(
    source: Annotated[Path, typer.Argument(help="An image, video, bag, sequence's folder, map.ply or run folder.")],
    camera: Annotated[
        str | None,
        typer.Option(help="What took the image: erp, pal, cubemap, pinhole:DEGREES, fisheye:DEGREES, or a file."),
    ] = None,
    as_: Annotated[
        str | None,
        typer.Option("--as", help="Camera to show it through, as in pinhole, erp, pal or pinhole:left. May be a list."),
    ] = None,
    dataset: Annotated[str | None, typer.Option(help="Dataset adapter; default: guessed.")] = None,
    sequence: Annotated[str | None, typer.Option(help="Sequence; default: the first.")] = None,
    topic: TopicOption = None,
    layout: LayoutOption = None,
    frames: Annotated[int, typer.Option(min=1, max=60, help="Frames of a sequence to show.")] = 4,
    fov: Annotated[str | None, typer.Option(help="Field of view of --as, 120 or 120x60.")] = None,
    width: Annotated[int | None, typer.Option(help="Width of --as in pixels.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder to write to; default: here.")] = None,
    open_: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Show an image, a sequence or a map through another camera.

    Writes NAME.sheet.png, the frames beside what the other camera would have seen, and for anything that
    covers a good part of the sphere NAME.html, one offline page in which to look around.

    A map is seen from the poses of its run, or from its origin where no run is around it; its page is one to walk
    through.
    """
    from rich.console import Console

    from panobench.bench.records.map_views import MapSequence, is_map
    from panobench.datasets.files.images import encode_image
    from panobench.datasets.given import Given
    from panobench.datasets.inspection.contact_sheet import contact_sheet
    from panobench.datasets.inspection.look_around import write_look_around_page
    from panobench.datasets.inspection.single_image import open_anything
    from panobench.writing import write_whole

    if is_map(source):
        opened: FrameSequence = MapSequence(source)
    else:
        opened = open_anything(source, camera, dataset, sequence, Given(topic=topic, layout=layout))
    chosen = _spread(len(opened), frames)
    choices = _choices(as_, opened, width, fov)
    rows = _rows(opened, chosen, choices)
    panoramas = [] if isinstance(opened, MapSequence) else _panoramas(opened, chosen)

    folder = out or Path()
    name = opened.name.replace("/", "-")
    sheet = contact_sheet(rows, f"{opened.name}: {opened.camera.kind} {opened.camera.width}x{opened.camera.height}")
    target = folder / f"{name}.sheet.png"
    write_whole(target, encode_image(sheet, ".png"))
    console = Console(highlight=False, soft_wrap=True)
    console.print(str(target))
    for remark in opened.remarks():
        typer.echo(f"note: {remark}", err=True)
    page = folder / f"{name}.html"
    if isinstance(opened, MapSequence):
        _write_walk(source, opened, page)
    elif panoramas:
        write_look_around_page(page, opened.name, panoramas)
    else:
        return
    console.print(str(page))
    if open_:
        typer.launch(page.resolve().as_uri())


def _write_walk(source: Path, opened: MapSequence, page: Path) -> None:
    """The page of a run's map, or of a map alone with the poses that lie beside it."""
    from panobench.api import Run
    from panobench.bench.records.runfolder import MAP, RUN_JSON
    from panobench.viewer.walk.page import Walk, walk_of_run, write_walk

    folder = source if source.is_dir() else source.parent
    if (folder / RUN_JSON).is_file() and (source.is_dir() or source.name == MAP):
        write_walk(walk_of_run(Run(folder)), page)
    else:
        poses = opened.poses if len(opened) > 1 else opened.poses[:0]
        write_walk(Walk(opened.name, opened.gaussians, poses), page)


def _spread(count: int, wanted: int) -> list[int]:
    """Evenly spaced frame indices, first and last included."""
    if wanted >= count:
        return list(range(count))
    return sorted({round(k * (count - 1) / max(wanted - 1, 1)) for k in range(wanted)})


def _choices(as_: str | None, opened: FrameSequence, width: int | None, fov: str | None) -> list[CameraChoice]:
    """The cameras to show: those named, else six pinhole views for a panorama and erp for the rest."""
    from panobench.cameras.factory import parse_camera_option

    kind = opened.camera.kind
    if as_ is None:
        as_ = "pinhole" if kind in ("erp", "cubemap") else "erp"
    options: list[str] = []
    for option in (o.strip() for o in as_.split(",")):
        if not option:
            raise UsageError("--as is empty: name a camera such as pinhole or erp")
        views = ("front", "left", "right", "back") if option == "pinhole" and kind != "pinhole" else ()
        options += [f"{option}:{v}" for v in views] or [option]
    return [parse_camera_option(o, opened.camera, width, fov) for o in options]


def _rows(opened: FrameSequence, chosen: list[int], choices: list[CameraChoice]) -> list[list[Cell]]:
    """One row per frame: the frame, then each camera's picture of it. Views that see nothing are left out."""
    from panobench.cameras.reproject import Reprojector
    from panobench.datasets.inspection.contact_sheet import Cell
    from panobench.errors import UnsupportedError

    reprojectors: list[Reprojector | None] = []
    blind: UnsupportedError | None = None
    for choice in choices:
        try:
            reprojectors.append(Reprojector(opened.camera, choice.camera, choice.R_target_source))
        except UnsupportedError as error:
            if len(choices) == 1:
                raise
            blind = error
            reprojectors.append(None)
    if blind is not None and not any(reprojectors):
        raise blind
    native = opened.camera.valid_mask()
    rows = []
    for index in chosen:
        image = opened.image(index)
        row = [Cell(image, f"{opened.frame_name(index)}  {opened.times[index] - opened.times[0]:.2f} s", native)]
        for choice, reprojector in zip(choices, reprojectors):
            if reprojector is not None:
                row.append(Cell(reprojector.image(image), choice.label, reprojector.valid))
        rows.append(row)
    return rows


def _panoramas(opened: FrameSequence, chosen: list[int]) -> list[tuple[str, np.ndarray]]:
    """(label, ERP image) of the chosen frames, or nothing for a camera that sees too little of the sphere."""
    import numpy as np

    from panobench.cameras.factory import parse_camera_option
    from panobench.cameras.reproject import Reprojector
    from panobench.datasets.files.images import resize_image
    from panobench.datasets.inspection.contact_sheet import shade_unseen

    coverage = opened.camera.solid_angle().sum() / (4 * np.pi)
    if coverage < _PAGE_COVERAGE:
        return []
    reprojector = None
    if opened.camera.kind != "erp":
        choice = parse_camera_option("erp", opened.camera)
        if choice.camera.width > _PAGE_WIDTH:
            choice = parse_camera_option("erp", opened.camera, _PAGE_WIDTH)
        reprojector = Reprojector(opened.camera, choice.camera, choice.R_target_source)
    found = []
    for index in chosen:
        image, valid = opened.image(index), opened.camera.valid_mask()
        if reprojector is not None:
            image, valid = reprojector.image(image), reprojector.valid
        image = shade_unseen(image, valid)
        if image.shape[1] > _PAGE_WIDTH:
            image = resize_image(image, _PAGE_WIDTH, _PAGE_WIDTH // 2)
        found.append((f"{opened.frame_name(index)}, {opened.times[index] - opened.times[0]:.2f} s", image))
    return found

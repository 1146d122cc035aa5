"""`panobench export`: a stored run for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="tum, kitti, ply-points, mesh, colmap, nerfstudio, ply-sh3, splat, spz, sog, mp4 or rrd.",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File or folder to write; default: beside the run.")
    ] = None,
    images: Annotated[
        bool, typer.Option(help="Read the frames from the data again: models hold them, a mesh's depth is put right.")
    ] = True,
    faces: Annotated[
        bool, typer.Option("--faces", help="For models of panoramas: the six faces of a cube instead of panoramas.")
    ] = False,
    voxel: Annotated[
        float | None, typer.Option(help="For mesh: edge of a voxel in the map's unit; default: 1/256 of the map.")
    ] = None,
    camera: Annotated[str, typer.Option(help="For mp4: erp, or pinhole:DEGREES.")] = "erp",
    width: Annotated[
        int | None,
        typer.Option(min=16, max=8192, help="Of a film, of faces, or of the frames read for a mesh, pixels."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="For mp4: how long it is.")] = 10.0,
) -> None:
    """Write a stored run's path, points, surface, splats, film or model for another program."""
    from panobench.api import Run
    from panobench.bench.export import ExportOptions, export_run

    options = ExportOptions(images=images, faces=faces, voxel=voxel, camera=camera, width=width, seconds=seconds)
    print(export_run(Run(run), to, output, options))

"""`panobench export`: a stored run for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    to: Annotated[str, typer.Option("--to", help="tum, kitti, ply-points, colmap or nerfstudio.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File or folder to write; default: beside the run.")
    ] = None,
    images: Annotated[bool, typer.Option(help="For models: write the frames too, read from the data again.")] = True,
) -> None:
    """Write a stored run's path, points or model for another program."""
    from panobench.api import Run
    from panobench.bench.export import export_run

    print(export_run(Run(run), to, output, images=images))

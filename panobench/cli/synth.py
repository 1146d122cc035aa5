"""`panobench synth` makes data sets in the formats of published ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()
def synth() -> None:
    """Make data in the formats of published data sets."""


@app.command()
def palvio(
    out: Annotated[Path, typer.Option(help="The bag to write.")] = Path("synthetic.bag"),
    dataset: Annotated[str, typer.Option(help="Panoramic dataset with ground truth to make it from.")] = "rooms",
    sequence: Annotated[str | None, typer.Option(help="Its sequence; default: the first.")] = None,
    root: Annotated[Path | None, typer.Option(help="Where that dataset is.")] = None,
    frames: Annotated[int, typer.Option(min=4, help="Images in the bag.")] = 60,
    width: Annotated[int | None, typer.Option(min=160, max=1280, help="Image width; default PALVIO's 1280.")] = None,
    source_width: Annotated[int, typer.Option(help="Width of the panoramas it is made from.")] = 1024,
    seed: Annotated[int, typer.Option(help="Seed of the IMU noise.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Write a ROS 1 bag with PALVIO's topics, types and calibration.

    Images are mono8 through the annular lens, the IMU runs at 200 Hz and the body's pose at 100 Hz. Read it
    with `panobench run --dataset palvio --root FOLDER`, or take it apart with `panobench convert palvio`.
    """
    from rich.console import Console
    from rich.progress import Progress

    from panobench.datasets.open import open_sequence
    from panobench.datasets.palvio_synth import BagOptions, write_palvio_bag

    opened = open_sequence(dataset, sequence, root, source_width)
    options = BagOptions(frames=frames, width=width, seed=seed)
    with Progress(console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(opened.name, total=min(frames, len(opened)))
        write_palvio_bag(out, opened, options, lambda n: bar.advance(task, n))
    Console(highlight=False, soft_wrap=True).print(f"{out}: {min(frames, len(opened))} images of '{opened.name}'")

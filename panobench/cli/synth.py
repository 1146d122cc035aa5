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
    frames: Annotated[
        int | None, typer.Option(min=4, help="Images in the bag; default 60, or all of --seconds.")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="Another camera than PALVIO's, for example pinhole; it looks ahead.")
    ] = None,
    fov: Annotated[str | None, typer.Option(help="Its field of view, 90 or 90x60 degrees.")] = None,
    width: Annotated[int | None, typer.Option(min=160, max=1280, help="Image width; default PALVIO's 1280.")] = None,
    source_width: Annotated[int, typer.Option(help="Width of the panoramas it is made from.")] = 1024,
    seconds: Annotated[
        float | None,
        typer.Option(min=1, max=600, help="Somebody walks in the room for so long, instead of its own path."),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.1, max=3, help="Of walking, m/s.")] = 1.0,
    turn: Annotated[float, typer.Option(min=0, max=720, help="Fastest turn of the head, degrees/s.")] = 60,
    gait: Annotated[float, typer.Option(min=0, max=4, help="Sway of the steps; 1 is a brisk walk's.")] = 1,
    still: Annotated[float, typer.Option(min=0, max=60, help="Seconds of standing at the start; 0: in motion.")] = 1,
    seed: Annotated[int, typer.Option(help="Another walk, other noise of the IMU.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Write a ROS 1 bag with PALVIO's topics, types and calibration.

    Images are mono8 through the annular lens, the IMU runs at 200 Hz and the body's pose at 100 Hz. Read it
    with `panobench run --dataset palvio --root FOLDER`, or take it apart with `panobench convert palvio`.
    """
    from rich.console import Console
    from rich.progress import Progress

    from panobench.cameras.erp import ErpCamera
    from panobench.cameras.factory import parse_camera_option
    from panobench.capture.stroll import StrollOptions
    from panobench.datasets.base import FrameSequence
    from panobench.datasets.open import open_sequence
    from panobench.datasets.palvio.synth import IMAGE_RATE_HZ, BagOptions, write_palvio_bag
    from panobench.datasets.synthetic.walked_room import WalkedRoom
    from panobench.errors import UsageError

    if camera is None and fov is not None:
        raise UsageError("--fov goes with --camera: PALVIO's lens has the field of view of its calibration")
    if seconds is None:
        opened: FrameSequence = open_sequence(dataset, sequence, root, source_width)
    else:
        if dataset != "rooms":
            raise UsageError(f"--seconds: only the built-in rooms can be walked through, not dataset '{dataset}'")
        walk = StrollOptions(seconds=seconds, speed=speed, turn_deg_s=turn, gait=gait, still_s=still, seed=seed)
        panorama = ErpCamera(source_width, source_width // 2)
        opened = WalkedRoom(sequence or "room2", walk, panorama, IMAGE_RATE_HZ)
    count = min(frames or (60 if seconds is None else len(opened)), len(opened))
    chosen = None if camera is None else parse_camera_option(camera, opened.camera, width, fov).camera
    options = BagOptions(frames=count, width=width, camera=chosen, seed=seed)
    with Progress(console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(opened.name, total=count)
        write_palvio_bag(out, opened, options, lambda n: bar.advance(task, n))
    Console(highlight=False, soft_wrap=True).print(f"{out}: {count} images of '{opened.name}'")


@app.command("hilti-360")
def hilti(
    out: Annotated[Path, typer.Option(help="Folder that gets floor_X/DATE/run_Z and groundtruth/.")] = Path(
        "hilti-synthetic"
    ),
    run: Annotated[str, typer.Option(help="Name of the run.")] = "floor_synthetic_2026-01-01_run_1",
    room: Annotated[str, typer.Option(help="Built-in room it is walked in; room2 and loop have four rooms.")] = "loop",
    seconds: Annotated[float, typer.Option(min=1, max=600, help="How long it takes; 5 s of it are not judged.")] = 60,
    width: Annotated[int | None, typer.Option(min=64, max=1472, help="Width of a lens's picture.")] = None,
    rate: Annotated[float, typer.Option(min=1, max=60, help="Images a second.")] = 30,
    speed: Annotated[float, typer.Option(min=0.1, max=3, help="Of walking, m/s.")] = 1.3,
    turn: Annotated[float, typer.Option(min=0, max=720, help="Fastest turn of the head, degrees/s.")] = 400,
    gait: Annotated[float, typer.Option(min=0, max=4, help="Sway of the steps; 1 is a brisk walk's.")] = 1,
    still: Annotated[float, typer.Option(min=0, max=60, help="Seconds of standing at the start; 0: in motion.")] = 1,
    operator: Annotated[float, typer.Option(min=0, max=0.35, help="Share of the sphere the operator hides.")] = 0.1,
    readout: Annotated[float, typer.Option(min=0, max=33, help="Milliseconds from first to last row.")] = 16,
    imu_noise: Annotated[float, typer.Option(min=0, max=100, help="Factor on the IMU's published noise.")] = 1,
    seed: Annotated[int, typer.Option(help="Another path, other noise.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Write a run of the Hilti challenge: a ROS 2 bag with two lenses and an IMU, and its ground truth.

    Both lenses are rendered from their own centres with a rolling shutter and the operator in view. At the full width a
    frame takes seconds; --width 184 is enough to try a method. Read it with `panobench run --dataset hilti-360 --root
    FOLDER`.
    """
    from dataclasses import fields

    from rich.console import Console
    from rich.progress import Progress

    from panobench.capture.imu import ImuNoise
    from panobench.capture.stroll import StrollOptions
    from panobench.datasets.hilti.calibration import NOISE
    from panobench.datasets.hilti.synth import HiltiSynthOptions, write_hilti_run

    walk = StrollOptions(seconds=seconds, speed=speed, turn_deg_s=turn, gait=gait, still_s=still, seed=seed)
    noise = ImuNoise(*(imu_noise * getattr(NOISE, f.name) for f in fields(NOISE)))
    options = HiltiSynthOptions(
        run, room, width, rate, readout_s=readout * 1e-3, operator=operator, walk=walk, noise=noise
    )
    with Progress(console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(run, total=int(seconds * rate))
        made = write_hilti_run(out, options, lambda n: bar.advance(task, n))
    Console(highlight=False, soft_wrap=True).print(f"{made.folder}: {made.frames} frames; truth in {made.truth}")

"""`panobench probe PATH`: what it is, what a run makes of it, and roughly what that costs.

Exit codes: 0 a run could read it, 2 it could not, with the line that the run would say.
"""

from __future__ import annotations

import json
from dataclasses import asdict
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
from panobench.errors import UnsupportedError

if TYPE_CHECKING:
    from panobench.datasets.inspection.probe import Probe

app = typer.Typer()


@app.command()
def probe(
    path: Annotated[Path, typer.Argument(help="A folder, video, bag, archive, project, calibration or trajectory.")],
    dataset: Annotated[str | None, typer.Option(help="Dataset adapter; default: guessed.")] = None,
    sequence: Annotated[str | None, typer.Option(help="Sequence; default: the first.")] = None,
    width: Annotated[int, typer.Option(min=16, help="Width of the images given to methods, for the cost.")] = 512,
    rate: RateOption = None,
    calibration: CalibrationOption = None,
    topic: TopicOption = None,
    imu_topic: ImuTopicOption = None,
    groundtruth_topic: TruthTopicOption = None,
    layout: LayoutOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what a path holds, what a run makes of it and what that costs, without running anything."""
    from panobench.datasets.given import Given
    from panobench.datasets.inspection.probe import probe as look

    given = Given(rate, calibration, topic, imu_topic, groundtruth_topic, layout)
    found = look(path, dataset=dataset, sequence=sequence, width=width, given=given)
    print(json.dumps(asdict(found), indent=2) if as_json else text(found))
    if found.problem:
        raise UnsupportedError(found.problem)


def text(found: Probe) -> str:
    """A few lines for people."""
    lines = [f"{found.path}: {found.what}" + (f" (--dataset {found.dataset})" if found.dataset else "")]

    def add(label: str, value: str) -> None:
        lines.append(f"{label:14}{value}")

    for number, line in enumerate(found.contents):
        add("" if number else "topics", line)
    if found.dataset and found.sequence:
        others = [name for name in found.sequences if name != found.sequence]
        more = f"; also {', '.join(others[:6])}{', ...' if len(others) > 6 else ''}" if others else ""
        add("sequence", f"{found.sequence}{more}")
        rate = f", {found.rate_hz:.3g} a second" if found.rate_hz else ""
        add("frames", f"{found.frames}, {found.duration_s:.1f} s{rate}")
        hidden = f", {100 * found.hidden:.0f}% hidden by a mask" if found.hidden > 0 else ""
        assert found.size is not None
        given = "" if found.given == found.size or not found.given else f"; methods get {_size(found.given)}"
        add("images", f"{_size(found.size)} {found.camera}{hidden}{given}")
        if found.truth is None:
            add("ground truth", "none")
        else:
            scale = "" if found.truth_scaled else ", without scale"
            add("ground truth", f"for {found.truth} of {found.frames} frames{scale}")
        if found.imu_samples:
            add("IMU", f"{found.imu_samples} samples")
        for cost in found.costs:
            add(cost.method, f"about {_time(cost.seconds)}, {cost.memory_bytes / 1e9:.1f} GB")
        lines.append("(rough, on two cores; the first run on a machine compiles kernels for a minute or two besides)")
    lines += [f"note: {remark}" for remark in found.remarks]
    lines.append(f"try: {found.command}")
    return "\n".join(lines)


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"

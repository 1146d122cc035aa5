"""Options of commands that open any data set and say to it what its files do not: ``panobench.datasets.given``."""

from __future__ import annotations

from typing import Annotated

import typer

RateOption = Annotated[float | None, typer.Option("--rate", help="Images a second, where they do not say.")]
CalibrationOption = Annotated[
    str | None, typer.Option("--calibration", help="What took the images: a calibration file.")
]
TopicOption = Annotated[str | None, typer.Option("--topic", help="Topic of a bag's images.")]
ImuTopicOption = Annotated[str | None, typer.Option("--imu-topic", help="Topic of a bag's IMU.")]
TruthTopicOption = Annotated[
    str | None, typer.Option("--groundtruth-topic", help="Topic of a bag's true poses, or none.")
]
LayoutOption = Annotated[str | None, typer.Option("--layout", help="How pictures hold the sphere; default: look.")]

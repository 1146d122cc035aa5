"""Run options that go to some datasets only: what took the images, how often, which topics."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

from panobench.errors import UsageError


@dataclass(frozen=True)
class Given:
    """rate: images a second. calibration: a file, FILE#CAMERA for one of several. topics: of a bag.

    groundtruth_topic may be "none". layout: how pictures hold the sphere (``layouts.names``).
    """

    rate: float | None = None
    calibration: str | None = None
    topic: str | None = None
    imu_topic: str | None = None
    groundtruth_topic: str | None = None
    layout: str | None = None

    def __post_init__(self) -> None:
        if self.rate is not None and not 0 < self.rate <= 1e5:
            raise UsageError(f"--rate {self.rate:g}: images a second, more than 0")

    def check(self, dataset: str, takes: Iterable[str]) -> None:
        """Raises UsageError for an option that the dataset has no use for."""
        takes = set(takes)
        for field in dataclasses.fields(self):
            if getattr(self, field.name) is not None and field.name not in takes:
                flag = "--" + field.name.replace("_", "-")
                raise UsageError(f"{flag}: dataset '{dataset}' has no use for it; it takes {_list(takes)}")


def _list(names: set[str]) -> str:
    return ", ".join("--" + name.replace("_", "-") for name in sorted(names)) or "no such option"

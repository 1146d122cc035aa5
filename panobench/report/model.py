"""What a report knows about runs: plain dataclasses, no files and no drawing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3
from panobench.studies.stored import StoredStudy
from panobench.types import Trajectory

Array = NDArray[np.float64]
Origin = Literal["measured", "imported", "published"]


@dataclass(frozen=True)
class ImagePair:
    """A rendered frame and the picture it should equal; ``truth`` is None when it was not stored.

    ``novel``: a view off the trajectory, numbered by itself.
    """

    frame: int
    render: Path
    truth: Path | None
    novel: bool = False


@dataclass(frozen=True)
class DepthPictures:
    """The depth a map was started with, and how sure the estimator was. Paths of pictures.

    span: 2nd and 98th percentile of the depth. oracle: the dataset's own depth was used.
    """

    depth: Path | None
    confidence: Path | None
    name: str = ""
    message: str = ""
    span: tuple[float, float] | None = None
    oracle: bool = False


@dataclass(frozen=True)
class Errors:
    """An aligned trajectory (N poses) and its error per pose against ground truth.

    times (N,) s; positions (N, 3) in the ground truth's world and unit; translation (N,) in that unit;
    rotation (N,) degrees. transform: from the estimate's world to the ground truth's. alignment: "Sim(3)",
    "SE(3)" or "none".
    """

    times: Array
    positions: Array
    translation: Array
    rotation: Array
    alignment: str
    transform: Sim3

    @property
    def rmse(self) -> float:
        """Root mean square of the translation error."""
        return float(np.sqrt(np.mean(self.translation**2)))


@dataclass(frozen=True)
class Run:
    """One run folder, read. ``numbers`` joins metrics and timing of run.json (None: not measured).

    true_depth: the method was given the dataset's own depth, so its accuracy is an upper bound.
    given_poses: it was given the poses too: its trajectory is no result, and its map an upper bound.
    """

    folder: Path
    identifier: str
    origin: Origin
    status: str
    message: str
    method: str
    dataset: str
    sequence: str
    seed: int | None
    variant: Mapping[str, str]
    numbers: Mapping[str, float | None]
    document: Mapping[str, Any]
    trajectory: Trajectory | None = None
    groundtruth: Trajectory | None = None
    errors: Errors | None = None
    keyframes: tuple[int, ...] = ()
    frames: Mapping[str, Array] = field(default_factory=dict)
    pairs: tuple[ImagePair, ...] = ()
    depth: DepthPictures | None = None
    log_tail: str = ""
    command: str = ""
    protocol: str = ""
    true_depth: bool = False
    given_poses: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def place(self) -> tuple[str, str]:
        """(dataset, sequence)."""
        return (self.dataset, self.sequence)

    def number(self, key: str) -> float | None:
        """A metric or timing value, None where it was not measured."""
        return self.numbers.get(key)


@dataclass(frozen=True)
class Problem:
    """A folder that looks like a run but cannot be read: shown, never dropped."""

    folder: Path
    message: str


@dataclass(frozen=True)
class Collection:
    """Everything a report is made from."""

    runs: tuple[Run, ...]
    problems: tuple[Problem, ...] = ()
    studies: tuple[StoredStudy, ...] = ()

    def places(self) -> list[tuple[str, str]]:
        """Distinct (dataset, sequence), sorted."""
        return sorted({run.place for run in self.runs})

    def at(self, place: tuple[str, str]) -> list[Run]:
        """The runs on one sequence, in reading order."""
        return [run for run in self.runs if run.place == place]

"""The runs of a report as plain dataclasses, without reading files or drawing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.cautions import cautions
from panobench.bench.records.record import RunRecord, VerdictRecord
from panobench.bench.records.study_record import StoredStudy
from panobench.geometry import Sim3
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
    """An aligned trajectory (N poses) and its error per pose against ground truth, as the run was scored.

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
        """Root mean square of the translation error: the ATE."""
        return float(np.sqrt(np.mean(self.translation**2)))


@dataclass(frozen=True)
class Run:
    """One run folder: its record, and the other files in it.

    frames: columns of frames.csv. pairs: renders beside what they should show. mask: a
    picture of where those were compared, white; None: everywhere. hidden: a frame on which the run's mask is drawn.
    warnings: files that cannot be read.
    """

    folder: Path
    record: RunRecord
    trajectory: Trajectory | None = None
    groundtruth: Trajectory | None = None
    errors: Errors | None = None
    frames: Mapping[str, Array] = field(default_factory=dict)
    pairs: tuple[ImagePair, ...] = ()
    mask: Path | None = None
    depth: DepthPictures | None = None
    hidden: Path | None = None
    log_tail: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def origin(self) -> Origin:
        """Who made the run."""
        origin: Origin = "measured"
        if self.record.origin in ("imported", "published"):
            origin = cast("Origin", self.record.origin)
        return origin

    @property
    def status(self) -> str:
        """How it ended."""
        return self.record.status

    @property
    def message(self) -> str:
        """Why it is not ok."""
        return self.record.message

    @property
    def method(self) -> str:
        """The method's name."""
        return self.record.spec.method or "unknown method"

    @property
    def dataset(self) -> str:
        """The dataset's name."""
        return self.record.spec.dataset or "unknown dataset"

    @property
    def sequence(self) -> str:
        """The sequence's name; the dataset's where it has none."""
        return self.record.spec.sequence or self.record.spec.dataset or "unknown sequence"

    @property
    def place(self) -> tuple[str, str]:
        """(dataset, sequence)."""
        return (self.dataset, self.sequence)

    @property
    def seed(self) -> int | None:
        """The seed, None where the file does not say."""
        return self.record.spec.seed

    @property
    def variant(self) -> Mapping[str, str]:
        """Run options that may set it apart from other runs of its method on its sequence, as text."""
        return self.record.spec.variants()

    @property
    def command(self) -> str:
        """The command that makes this run again, "" if it was not recorded."""
        return self.record.provenance.command

    @property
    def protocol(self) -> str:
        """The protocol it was scored under."""
        return self.record.protocol

    @property
    def true_depth(self) -> bool:
        """The method was given the dataset's own depth, so its accuracy is an upper bound."""
        return self.record.depth.oracle

    @property
    def given_poses(self) -> bool:
        """It was given the poses: its trajectory is no result, and its map an upper bound."""
        return self.record.depth.poses_given

    @property
    def cautions(self) -> tuple[str, ...]:
        """What a reader must know before comparing it; see ``bench.cautions``."""
        return cautions(self.record)

    @property
    def truncated(self) -> int | None:
        """The number of frames it stopped after because it was asked to, None where it had the whole sequence."""
        most, planned = self.record.spec.option("max_frames"), self.record.frames.planned
        return most if most is not None and (planned is None or planned >= most) else None

    def option(self, name: str) -> str:
        """A run option that took effect, as text; "" for none."""
        return self.variant.get(name, "")

    @property
    def verdict(self) -> VerdictRecord | None:
        """Whether it is right, as far as can be known without ground truth."""
        return self.record.verdict

    @property
    def doubtful(self) -> bool:
        """The verdict is not "trusted"."""
        return self.record.verdict is not None and self.record.verdict.word != "trusted"

    def number(self, key: str) -> float | None:
        """A metric or timing, the size of the map, or "ate_percent" of the path; None where it was not measured."""
        value = self.record.number(key)
        if value is None and key == "map_gaussians" and self.record.map is not None:
            return self.record.map.gaussians
        if value is None and key == "ate_percent" and self.trajectory is not None and self.groundtruth is not None:
            path, ate = self.groundtruth.path_length(), self.record.number("ate_rmse_m")
            return 100.0 * ate / path if ate is not None and path > 0 else None
        return value


@dataclass(frozen=True)
class Problem:
    """A folder that looks like a run but cannot be read. Reports show it."""

    folder: Path
    message: str


@dataclass(frozen=True)
class Collection:
    """Everything a report is made from. written: the files of the report, once there is one."""

    runs: tuple[Run, ...]
    problems: tuple[Problem, ...] = ()
    studies: tuple[StoredStudy, ...] = ()
    written: tuple[Path, ...] = ()

    def places(self) -> list[tuple[str, str]]:
        """Distinct (dataset, sequence), sorted."""
        return sorted({run.place for run in self.runs})

    def at(self, place: tuple[str, str]) -> list[Run]:
        """The runs on one sequence, in reading order."""
        return [run for run in self.runs if run.place == place]

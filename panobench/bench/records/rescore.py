"""Score stored runs again, under the current protocol or another one, from their files alone.

Trajectory metrics and the status are computed again. Rendering metrics, which need the renderer, and times stay as
they were measured.
"""

from __future__ import annotations

import csv
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.record import RescoredRecord, RunRecord, read_record, write_record
from panobench.bench.records.runfolder import FRAMES, GROUNDTRUTH, RUN_JSON, TRAJECTORY, PendingRun
from panobench.bench.run.evaluate import judge
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_io import read_rows, read_tum
from panobench.errors import InputError, UsageError
from panobench.metrics.base import FAILED_ATE_M, MIN_TRACKED, PROTOCOL_VERSION, MetricInput
from panobench.types import Estimate, RunStatus, Trajectory
from panobench.writing import writing

Alignment = Literal["auto", "sim3", "se3", "none"]
ALIGNMENTS: tuple[Alignment, ...] = ("auto", "sim3", "se3", "none")
#: Statuses that scoring decides; a run that ended otherwise keeps its status.
_JUDGED = (RunStatus.OK.value, RunStatus.LOST.value)


@dataclass(frozen=True)
class Protocol:
    """A protocol, by what differs from the current one. skip_s: seconds left out at the start of the trajectory."""

    alignment: Alignment = "auto"
    min_tracked: float = MIN_TRACKED
    failed_ate_m: float = FAILED_ATE_M
    skip_s: float = 0.0

    def __post_init__(self) -> None:
        if self.alignment not in ALIGNMENTS:
            raise UsageError(f"--align {self.alignment}: expected one of {', '.join(ALIGNMENTS)}")
        if not (0 <= self.min_tracked <= 1 and self.failed_ate_m > 0 and 0 <= self.skip_s < np.inf):
            raise UsageError("--min-tracked lies in 0..1, --max-ate is positive, --skip is not negative")

    @property
    def name(self) -> str:
        """The current version, and what differs from it: "1.3+align=se3"."""
        default = Protocol()
        changed = [
            f"{key}={getattr(self, key):g}" if key != "alignment" else f"align={self.alignment}"
            for key in ("alignment", "min_tracked", "failed_ate_m", "skip_s")
            if getattr(self, key) != getattr(default, key)
        ]
        return "+".join([PROTOCOL_VERSION, *changed])

    @classmethod
    def of(cls, record: RunRecord) -> Protocol:
        """The protocol whose name the record states; what the name does not say is taken from the current one."""
        version, *changed = record.protocol.split("+")
        given = dict(word.partition("=")[::2] for word in changed)
        # protocol 1.0 kept the scale of methods that say it is metric
        usual = "se3" if version == "1.0" and record.metric else "auto"
        alignment: Alignment = next((a for a in ALIGNMENTS if a == given.get("align", usual)), "auto")
        try:
            return cls(alignment, skip_s=float(given.get("skip_s", 0)))
        except (ValueError, UsageError):
            return cls(alignment)


class StoredSequence(FrameSequence):
    """Times and ground truth of a stored run; its images are not kept."""

    def __init__(
        self,
        times: NDArray[np.float64],
        truth: Trajectory | None,
        scaled: bool = True,
        up: NDArray[np.float64] | None = None,
    ) -> None:
        self.name, self.dataset, self.times, self._truth, self._scaled = "stored", "stored", times, truth, scaled
        self._up = up

    def image(self, index: int) -> NDArray[np.uint8]:
        raise InputError("a stored run keeps no images")

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._truth

    @property
    def groundtruth_scaled(self) -> bool:
        return self._scaled

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return self._up


def rescore(folder: Path, protocol: Protocol) -> RunRecord:
    """The run's record with new trajectory numbers and status. Raises InputError for a folder it cannot use."""
    from panobench.metrics.trajectory import trajectory_metrics

    record = read_record(folder)
    if record.status not in (*_JUDGED, RunStatus.INTERRUPTED.value):
        return replace(record, protocol=protocol.name)
    times = frame_times(folder / FRAMES)
    estimate = _optional_tum(folder / TRAJECTORY)
    if len(times) == 0:
        raise InputError("no frames to score", folder / FRAMES)
    given = int((times >= times[0] + protocol.skip_s).sum())
    estimate = estimate.select(np.flatnonzero(estimate.times >= times[0] + protocol.skip_s - 1e-6))
    keyframes = [k for k in record.keyframes if 0 <= k < len(times)]
    truth = _optional_tum(folder / GROUNDTRUTH) if (folder / GROUNDTRUTH).is_file() else None
    up = None if record.truth is None or record.truth.up is None else np.array(record.truth.up)
    keyframes_only = record.imported is not None and record.imported.keyframes
    data = MetricInput(
        StoredSequence(times, truth, record.groundtruth_scaled, up),
        Estimate(estimate, keyframes=keyframes, metric=record.metric, gravity_aligned=record.gravity_aligned),
        list(range(len(times))),
        alignment=protocol.alignment,
        keyframes_only=keyframes_only,
    )
    cleared = dict.fromkeys(_trajectory_keys())
    metrics = {
        **record.metrics,
        **cleared,
        **trajectory_metrics(data),
        "tracked": len(estimate) / given if given else 0.0,
    }
    status, message = record.status, record.message
    if status in _JUDGED:
        found, message = judge(metrics, 0.0 if keyframes_only else protocol.min_tracked, protocol.failed_ate_m)
        status = found.value
    return replace(
        record,
        status=status,
        message=message,
        metrics=metrics,
        notes={**record.notes, **data.notes},
        protocol=protocol.name,
        rescored_from=record.rescored_from or RescoredRecord(record.protocol, record.status),
    )


def _trajectory_keys() -> list[str]:
    from panobench.metrics.registration import METRICS

    return list(next(m for m in METRICS if m.name == "trajectory").keys)


def frame_times(path: Path) -> NDArray[np.float64]:
    """Times (N,) of a run's frames from its frames.csv. Raises InputError."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            times = np.array([float(row["time"]) for row in csv.DictReader(file)], dtype=np.float64)
    except FileNotFoundError:
        raise InputError("the file is missing", path) from None
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise InputError(f"not a table of frames with times ({type(error).__name__})", path) from None
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise InputError("the times are not finite and increasing", path)
    return times


def _optional_tum(path: Path) -> Trajectory:
    """A TUM file; a trajectory without poses is empty, not wrong."""
    if not read_rows(path):
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    return read_tum(path)


def write_copy(folder: Path, record: RunRecord, target: Path) -> Path:
    """A run folder at ``target`` with the new record; the other files are hard links where possible."""
    with PendingRun(target) as pending:
        with writing(target):
            for source in sorted(folder.rglob("*")):
                _copy(source, pending.path / source.relative_to(folder))
            (pending.path / RUN_JSON).unlink()
            write_record(pending.path, record)
        return pending.publish()


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        target.mkdir()
        return
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)

"""Stored runs as the files that the Hilti challenge takes: one trajectory for each run, cam0's poses in metres.

What the organisers ask for ("What to Deliver", https://github.com/Hilti-Research/hilti-trimble-slam-challenge-2026):
TUM rows at the recording's stamps, files called floor_X_YYYY-MM-DD_run_Z.txt, poses for 99% of the ground truth's,
which begins 5 s after the first image, and a trajectory in metres.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.record import RunRecord, read_record
from panobench.bench.records.rescore import frame_times
from panobench.bench.records.runfolder import FRAMES, TRAJECTORY
from panobench.datasets.files.trajectory_io import read_rows, read_tum, write_tum
from panobench.datasets.hilti.calibration import UNJUDGED_S
from panobench.datasets.hilti.layout import FLOORS, RUN_NAME
from panobench.errors import InputError, UsageError
from panobench.geometry import invert_pose, make_pose
from panobench.metrics.challenge import DATASET, LEAST_COVERAGE
from panobench.types import Trajectory
from panobench.writing import writing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Submitted:
    """One run: its sequence, the file written (None: it was not), why not, and what one should know of it."""

    run: Path
    sequence: str
    file: Path | None
    problems: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    poses: int = 0


def write_submission(runs: Sequence[Path], out: Path) -> list[Submitted]:
    """Write a file below ``out`` for each run that has no problem. Raises UsageError for two runs of one sequence."""
    records = [(folder, read_record(folder)) for folder in runs]
    twice = [name for name, count in Counter(r.spec.sequence for _, r in records).items() if count > 1]
    if twice:
        raise UsageError(f"two runs on {twice[0]}: choose one of them")
    return [_submit(folder, record, out) for folder, record in records]


def _submit(folder: Path, record: RunRecord, out: Path) -> Submitted:
    name = record.spec.sequence
    problems = _named_wrongly(record)
    if problems:
        return Submitted(folder, name, None, tuple(problems))
    trajectory = read_tum(folder / TRAJECTORY) if read_rows(folder / TRAJECTORY) else None
    times = frame_times(folder / FRAMES)
    if trajectory is None or not len(times):
        return Submitted(folder, name, None, ("it has no poses",))
    problems += _incomplete(record, trajectory, times)
    doubts = []
    if not record.metric:
        doubts.append(f"{record.method.name} does not say that its scale is metres, and none is aligned")
    if problems:
        return Submitted(folder, name, None, tuple(problems), tuple(doubts), len(trajectory))
    path = out / f"{name}.txt"
    with writing(path):
        out.mkdir(parents=True, exist_ok=True)
        write_tum(path, cam0_poses(trajectory, record.provenance.dataset, folder))
    check_file(path)
    return Submitted(folder, name, path, (), tuple(doubts), len(trajectory))


def _named_wrongly(record: RunRecord) -> list[str]:
    if record.spec.dataset != DATASET:
        return [f"it is a run on {record.spec.dataset or 'no data set'}, not on {DATASET}"]
    match = RUN_NAME.fullmatch(record.spec.sequence)
    if match is None:
        return [f"'{record.spec.sequence}' is not called floor_X_YYYY-MM-DD_run_Z"]
    return [] if match[1] in FLOORS else [f"the organisers have no floor '{match[1]}'"]


def _incomplete(record: RunRecord, trajectory: Trajectory, times: Array) -> list[str]:
    problems = []
    if record.spec.option("every") != 1 or record.spec.option("max_frames") is not None:
        problems.append("it has a part of the frames (--every, --max-frames)")
    elif record.frames.planned and record.frames.given < record.frames.planned:
        problems.append(f"it ended after {record.frames.given} of {record.frames.planned} frames")
    judged = times[times >= times[0] + UNJUDGED_S]
    have = int(np.isin(np.round(judged, 6), np.round(trajectory.times, 6)).sum())
    if have < LEAST_COVERAGE * len(judged):
        problems.append(f"{have} of {len(judged)} frames after the first 5 s have a pose, under 99% scores 0")
    return problems


def cam0_poses(trajectory: Trajectory, about: dict[str, Any], folder: Path) -> Trajectory:
    """cam0's poses from those of the camera that the method saw. ``about``: what run.json says of the data."""
    T_cam0_rig = np.asarray(about.get("T_cam0_rig", ()), dtype=np.float64)
    if T_cam0_rig.shape != (4, 4):
        raise InputError("run.json does not say where cam0 is (T_cam0_rig)", folder)
    R_camera_rig = np.asarray(about.get("conversion", {}).get("R_target_source", np.eye(3)), dtype=np.float64)
    T_w_rig = trajectory.T_wc @ make_pose(R_camera_rig, np.zeros(3))
    return Trajectory(trajectory.times, T_w_rig @ invert_pose(T_cam0_rig))


def check_file(path: Path) -> Trajectory:
    """The poses of a file as the organisers read it. Raises InputError or DatasetError for one that they would not."""
    if RUN_NAME.fullmatch(path.stem) is None or path.suffix != ".txt":
        raise InputError("the file must be called floor_X_YYYY-MM-DD_run_Z.txt", path)
    found = read_tum(path)
    if not len(found):
        raise InputError("the file has no pose", path)
    return found

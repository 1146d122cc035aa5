"""Reading the trajectory that a program wrote, and matching it to the frames that it was given."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files import trajectory_io as io
from panobench.errors import DatasetError
from panobench.geometry import invert_pose
from panobench.types import Trajectory

Kind = Literal["tum", "tum-ns", "kitti", "euroc", "csv"]


@dataclass(frozen=True)
class TrajectoryFormat:
    """The format of a program's trajectory.

    kind: "tum", times in seconds; "tum-ns", TUM with times in nanoseconds (ORB-SLAM3); "kitti", one pose per frame;
    "euroc", CSV with times in nanoseconds and qw first, unless a header names the columns in another order; "csv", a
    table with a header, whose times are in the unit it names, or else as far apart as samples are. inverse: poses are
    world-to-camera. time_offset: seconds to add to the times. T_body_camera: poses are of a body; the camera's pose is
    T_world_body T_body_camera. index_rate: times are frame index / rate, for programs that take no times.
    """

    kind: Kind = "tum"
    inverse: bool = False
    time_offset: float = 0.0
    T_body_camera: NDArray[np.float64] | None = None
    index_rate: float | None = None


#: Seconds in a unit of the times of the files that a program writes. A "csv" names its unit, or its times tell it.
UNITS: dict[str, float | None] = {"tum": 1.0, "tum-ns": 1e-9, "euroc": 1e-9, "csv": None}


def read_answer(path: Path, form: TrajectoryFormat, times: NDArray[np.float64]) -> Trajectory:
    """The poses, stamped with those of ``times`` that they belong to. Empty if the program wrote an empty file.

    Raises DatasetError for a missing file, a line that does not parse, a time that belongs to no frame, and two poses
    of one frame.
    """
    if not path.exists():
        raise DatasetError("the program wrote no such file", path)
    if not any(line and not line.startswith("#") for line in _first_lines(path)):
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    if form.kind == "kitti":
        found = io.read_kitti(path, times)
    else:
        found = io.READERS[form.kind](path, UNITS[form.kind])
    T = found.T_wc
    if form.inverse:
        T = invert_pose(T)
    if form.T_body_camera is not None:
        T = T @ form.T_body_camera
    stamps = found.times + form.time_offset
    if form.index_rate is not None:
        index = np.rint(stamps * form.index_rate).astype(int)
        wrong = (index < 0) | (index >= len(times)) | (np.abs(index / form.index_rate - stamps) > 0.4 / form.index_rate)
    else:
        index, wrong = match_times(stamps, times)
    if wrong.any():
        stamp = stamps[int(np.flatnonzero(wrong)[0])]
        raise DatasetError(f"time {stamp:.9g} s belongs to none of the {len(times)} frames given", path)
    if (np.diff(index) <= 0).any():
        raise DatasetError("two poses belong to the same frame", path, frame=int(index[1:][np.diff(index) <= 0][0]))
    return Trajectory(times[index], T)


def match_times(stamps: NDArray[np.float64], times: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """For each stamp, the index of the nearest of the increasing ``times``, and whether it is too far away.

    Programs round their times: stamps match within 40% of the smallest interval.
    """
    right = np.clip(np.searchsorted(times, stamps), 1, max(1, len(times) - 1))
    right = np.minimum(right, len(times) - 1)
    left = np.maximum(right - 1, 0)
    index = np.where(np.abs(stamps - times[left]) <= np.abs(stamps - times[right]), left, right)
    interval = float(np.diff(times).min()) if len(times) > 1 else 1.0
    return index, np.asarray(np.abs(times[index] - stamps) > 0.4 * interval)


def _first_lines(path: Path) -> list[str]:
    """Stripped lines of the first 64 kB of a file. A binary file gives lines that fail to parse later."""
    with path.open("rb") as file:
        return [line.strip() for line in file.read(65536).decode("utf-8", errors="replace").splitlines()]

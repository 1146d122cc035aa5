"""Trajectory files: TUM (read, write), KITTI, EuRoC CSV; and the strict text tables they are made of.

A row that does not parse, a time that is NaN or not later than the one before, or a quaternion that
is no rotation raises DatasetError with file and line.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.errors import DatasetError
from panobench.geometry import make_pose, matrix_from_quaternion, quaternion_from_matrix, renormalise
from panobench.types import Trajectory

Array = NDArray[np.float64]
#: A text table larger than this is refused (a trajectory of a million poses has about 100 MB).
MAX_TEXT_BYTES = 512 << 20


@dataclass(frozen=True)
class Row:
    """One non-comment line of a text table."""

    line: int
    fields: list[str]


def read_rows(path: Path, *, delimiter: str | None = None) -> list[Row]:
    """Rows of a text table without blank lines and ``#`` comments; delimiter None is white space.

    Raises DatasetError if the file is missing, too large or not UTF-8 text.
    """
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise DatasetError(f"the file is over {MAX_TEXT_BYTES >> 20} MiB, too large for a text table", path)
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise DatasetError("the file is missing", path) from None
    except OSError as error:
        raise DatasetError(f"the file cannot be read ({error.strerror})", path) from error
    except UnicodeDecodeError:
        raise DatasetError("the file is not UTF-8 text", path) from None
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped and not stripped.startswith("#"):
            rows.append(Row(number, [f.strip() for f in stripped.split(delimiter)]))
    return rows


def parse_floats(row: Row, fields: Iterable[str], path: Path, expected: str) -> list[float]:
    """``fields`` of ``row`` as finite numbers, or DatasetError that says what the row should hold."""
    values = []
    for text in fields:
        try:
            value = float(text)
        except ValueError:
            raise DatasetError(f"'{text}' is not a number (expected: {expected})", path, line=row.line) from None
        if not np.isfinite(value):
            raise DatasetError(f"'{text}' is not a finite number (expected: {expected})", path, line=row.line)
        values.append(value)
    return values


def read_table(
    path: Path,
    columns: int,
    expected: str,
    *,
    delimiter: str | None = None,
    header: bool = False,
    exact: bool = False,
) -> tuple[Array, list[int]]:
    """(N, columns) finite numbers and the N line numbers.

    ``header``: the first row may be a header of words. ``exact``: more fields than ``columns`` are an
    error too (fewer always are).
    """
    rows = read_rows(path, delimiter=delimiter)
    if header and rows and not _is_number(rows[0].fields[0]):
        rows = rows[1:]
    values = []
    for row in rows:
        n = len(row.fields)
        if n < columns or (exact and n > columns):
            raise DatasetError(f"the row has {n} values, expected {columns}: {expected}", path, line=row.line)
        values.append(parse_floats(row, row.fields[:columns], path, expected))
    return np.array(values, dtype=np.float64).reshape(-1, columns), [row.line for row in rows]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def check_times(times: Array, path: Path, lines: list[int] | None = None) -> None:
    """Raise DatasetError unless ``times`` are finite and strictly increasing."""

    def where(i: int) -> tuple[int | None, int | None]:
        return (lines[i], None) if lines else (None, i)

    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        line, frame = where(int(bad[0]))
        raise DatasetError("the time is not a finite number", path, line=line, frame=frame)
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        i = int(late[0]) + 1
        line, frame = where(i)
        raise DatasetError(
            f"time {_seconds(times[i])} s is not later than the one before ({_seconds(times[i - 1])} s)",
            path,
            line=line,
            frame=frame,
        )


def _seconds(time: float) -> str:
    """A time without trailing zeros, to the nanosecond."""
    return f"{time:.9f}".rstrip("0").rstrip(".")


def poses_from_rows(rows: Array, path: Path, lines: list[int]) -> Array:
    """Rows ``x y z qx qy qz qw`` (N, 7), the order in which files store poses -> poses (N, 4, 4).

    Raises DatasetError with the line, of ``lines`` (N), whose quaternion's norm is not 1 within 5%.
    """
    norm = np.linalg.norm(rows[:, 3:], axis=-1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.05)
    if len(bad):
        i = int(bad[0])
        raise DatasetError(f"the quaternion has norm {norm[i]:.4g}, not 1", path, line=lines[i])
    return make_pose(matrix_from_quaternion(rows[:, [6, 3, 4, 5]]), rows[:, :3])


def rows_from_poses(T_wc: Array) -> Array:
    """Poses (N, 4, 4) -> rows ``x y z qx qy qz qw`` (N, 7), the order in which files store poses."""
    q = quaternion_from_matrix(T_wc[:, :3, :3])
    return np.concatenate([T_wc[:, :3, 3], q[:, [1, 2, 3, 0]]], axis=1)


def read_tum(path: Path) -> Trajectory:
    """TUM: ``time x y z qx qy qz qw`` per line, ``#`` comments. Raises DatasetError with file:line."""
    expected = "time x y z qx qy qz qw"
    table, lines = read_table(path, 8, expected, exact=True)
    if not len(table):
        raise DatasetError("the trajectory has no pose", path)
    check_times(table[:, 0], path, lines)
    return Trajectory(table[:, 0].copy(), poses_from_rows(table[:, 1:8], path, lines))


def tum_text(trajectory: Trajectory) -> str:
    """The content of a TUM file: times to the nanosecond, the rest exact to float64 round trip."""
    lines = ["# time x y z qx qy qz qw (camera-to-world)"]
    for t, row in zip(trajectory.times, rows_from_poses(trajectory.T_wc)):
        lines.append(" ".join([f"{t:.9f}", *(f"{x:.12g}" for x in row[:3]), *(f"{x:.15g}" for x in row[3:])]))
    return "\n".join(lines) + "\n"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a TUM file."""
    path.write_text(tum_text(trajectory), encoding="utf-8")


def read_kitti(path: Path, times: ArrayLike) -> Trajectory:
    """KITTI: the 12 numbers of [R | t] row by row per line; line k is the pose at ``times[k]``."""
    stamps = np.asarray(times, dtype=np.float64)
    table, lines = read_table(path, 12, "12 numbers of [R | t], row by row", exact=True)
    if not len(table):
        raise DatasetError("the trajectory has no pose", path)
    if len(table) != len(stamps):
        raise DatasetError(f"the file has {len(table)} poses for {len(stamps)} frames", path)
    check_times(stamps, path)
    T = table.reshape(-1, 3, 4)
    R = T[:, :, :3]
    residual = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((residual > 1e-2) | (np.linalg.det(R) < 0))
    if len(bad):
        raise DatasetError("the 3x3 part is not a rotation", path, line=lines[int(bad[0])])
    return Trajectory(stamps.copy(), renormalise(make_pose(R, T[:, :, 3])))


def read_euroc_csv(path: Path) -> Trajectory:
    """EuRoC ground truth: ``time[ns], x, y, z, qw, qx, qy, qz, ...`` with commas; further columns are ignored."""
    expected = "time in ns, x, y, z, qw, qx, qy, qz"
    table, lines = read_table(path, 8, expected, delimiter=",", header=True)
    if not len(table):
        raise DatasetError("the trajectory has no pose", path)
    times = table[:, 0] * 1e-9
    check_times(times, path, lines)
    return Trajectory(times, poses_from_rows(table[:, [1, 2, 3, 5, 6, 7, 4]], path, lines))

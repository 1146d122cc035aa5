"""Poses written as matrices: 12 or 16 numbers a row (KITTI is the former), or blocks of three or four rows of four.

A number before them is a time; a header may name it. Blocks may have a line of whole numbers before each (Redwood's
.log). A file without times has one pose for every frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from panobench.datasets.files.columns import is_header
from panobench.datasets.files.trajectory_io import NamedRows, Row, check_times, parse_floats, read_named_rows, time_unit
from panobench.errors import DatasetError
from panobench.geometry import make_pose, renormalise
from panobench.trajectories.posed import Array, PoseList

_EXPECTED = "12 or 16 numbers of [R | t], row by row, after a time or not"
#: Words in a header that say the first column is a frame's number.
_NUMBERS = {"frame", "index", "id", "idx", "frame_id", "frameid", "frame_index", "number"}


def is_matrices(table: NamedRows) -> bool:
    """By the length of the first rows."""
    lengths = [len(row.fields) for row in table.rows[:5]]
    where = table.columns
    if not lengths or where.quaternion is not None or (table.written and where.position is not None):
        return False
    return lengths[0] in (12, 13, 16, 17) or _is_blocks(lengths)


def _is_blocks(lengths: list[int]) -> bool:
    first = 1 if lengths[0] in (1, 3) else 0
    return lengths[first : first + 3] == [4, 4, 4]


def read_poses(path: Path, unit_s: float | None = None) -> PoseList:
    """Raises DatasetError with the line for a row of another length, or one that is no rigid motion."""
    table = read_named_rows(path)
    if not table.rows:
        raise DatasetError("the trajectory has no pose", path)
    lengths = [len(row.fields) for row in table.rows[:5]]
    if _is_blocks(lengths):
        values, lines = _blocks(table.rows, path)
        return _counted(values, lines, path)
    columns = lengths[0]
    rows = []
    for row in table.rows:
        if len(row.fields) != columns:
            raise DatasetError(
                f"the row has {len(row.fields)} values, expected {columns}: {_EXPECTED}", path, line=row.line
            )
        rows.append(parse_floats(row, row.fields, path, _EXPECTED))
    values, lines = np.array(rows), [row.line for row in table.rows]
    if columns not in (12, 13, 16, 17):
        raise DatasetError(f"the row has {columns} values, expected {_EXPECTED}", path, line=lines[0])
    if columns in (12, 16):
        return _counted(values, lines, path)
    poses, stamps = _rigid(values[:, 1:], path, lines), values[:, 0]
    if _first_name(path) in _NUMBERS and (stamps == np.rint(stamps)).all() and np.abs(stamps).max() < 1 << 40:
        return PoseList(poses, "matrices", numbers=stamps.astype(np.int64))
    times = stamps * (unit_s or table.columns.unit_s or time_unit(stamps, 1.0))
    check_times(times, path, lines)
    return PoseList(poses, "matrices", times=times)


def _first_name(path: Path) -> str:
    """What a header calls the first column, "" without one."""
    with path.open("rb") as file:
        line = file.readline(4096).decode("utf-8", "replace").lstrip("# ").strip()
    names = [name.strip().lower() for name in line.replace(";", ",").split("," if "," in line or ";" in line else None)]
    return names[0] if names and is_header(names) else ""


def _counted(values: Array, lines: list[int], path: Path) -> PoseList:
    poses = _rigid(values, path, lines)
    return PoseList(poses, "matrices", numbers=np.arange(len(poses)), counted=True)


def _blocks(rows: list[Row], path: Path) -> tuple[Array, list[int]]:
    """(N, 12) numbers, and the line where each block starts."""
    kept = [row for row in rows if len(row.fields) == 4]
    odd = next((row for row in rows if len(row.fields) not in (1, 3, 4)), None)
    if odd is not None:
        raise DatasetError(f"the row has {len(odd.fields)} values, expected 4: a row of a matrix", path, line=odd.line)
    values = np.array([parse_floats(row, row.fields, path, "a row of a matrix") for row in kept])
    height = 4 if len(values) % 4 == 0 and np.allclose(values[3::4], [0, 0, 0, 1], atol=1e-6) else 3
    if len(values) % height:
        raise DatasetError("the last matrix is cut short", path, line=kept[-1].line)
    blocks = values.reshape(-1, height, 4)[:, :3]
    return blocks.reshape(-1, 12), [row.line for row in kept[::height]]


def _rigid(values: Array, path: Path, lines: list[int]) -> Array:
    """Rows (N, 12) or (N, 16) -> poses. Raises DatasetError with the line."""
    T = values.reshape(len(values), -1, 4)
    if T.shape[1] == 4:
        bad = np.flatnonzero(np.abs(T[:, 3] - [0, 0, 0, 1]).max(axis=1) > 1e-3)
        if len(bad):
            raise DatasetError("the last row of the 4x4 matrix is not 0 0 0 1", path, line=lines[int(bad[0])])
    R = T[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        residual = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
        bad = np.flatnonzero(~((residual <= 1e-2) & (np.linalg.det(R) > 0)))
    if len(bad):
        raise DatasetError("the 3x3 part is not a rotation", path, line=lines[int(bad[0])])
    return renormalise(make_pose(R, T[:, :3, 3]))

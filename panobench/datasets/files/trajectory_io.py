"""Trajectory files: TUM (read, write), KITTI, CSV by header; and the strict text tables they are made of.

A row that does not parse, a time that is NaN or not later than the one before, or a quaternion that
is no rotation raises DatasetError with file and line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.datasets.files.columns import Columns, columns, is_header
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
    """Rows of a text table without blank lines and comments; delimiter None is white space.

    Raises DatasetError if the file is missing, too large or not UTF-8 text.
    """
    lines = [(number, line) for number, line in _lines(path) if not _is_comment(line)]
    return [Row(number, [f.strip() for f in line.split(delimiter)]) for number, line in lines]


def _is_comment(line: str) -> bool:
    """``#``, Matlab's ``%`` or C's ``//``. ``rostopic echo -p`` writes its header as ``%time,...``: no comment."""
    return line.startswith(("#", "//")) or (line.startswith("%") and not line.startswith("%time"))


def _lines(path: Path) -> list[tuple[int, str]]:
    """(number, text) of the lines that are not blank."""
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
    stripped = ((number, line.strip()) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, line) for number, line in stripped if line]


@dataclass(frozen=True)
class NamedRows:
    """Rows with what their header says. written: the header is a row of its own, not a comment that looks like one."""

    rows: list[Row]
    columns: Columns
    written: bool
    delimiter: str | None


def read_named_rows(path: Path) -> NamedRows:
    """Rows separated by commas, semicolons or white space, and their header: a first row of words, or a comment just
    before the first row with as many names as it has values. Decimal commas are read where semicolons separate.
    """
    lines = _lines(path)
    first = next((k for k, (_, line) in enumerate(lines) if not _is_comment(line)), len(lines))
    if first == len(lines):
        return NamedRows([], Columns(), False, None)
    sample = lines[min(first + 1, len(lines) - 1)][1]
    delimiter = next((d for d in (";", ",") if d in sample), None)

    def split(line: str) -> list[str]:
        fields = [f.strip() for f in line.split(delimiter)]
        return [f.replace(",", ".") for f in fields] if delimiter == ";" else fields

    rows = [Row(number, split(line)) for number, line in lines[first:] if not _is_comment(line)]
    if delimiter and all(len(row.fields) > 1 and not row.fields[-1] for row in rows):  # each row ends with a comma
        rows = [Row(row.line, row.fields[:-1]) for row in rows]
    if len(rows) > 1 and is_header(rows[0].fields):
        return NamedRows(rows[1:], columns(rows[0].fields), True, delimiter)
    names = split(lines[first - 1][1].lstrip("#%/ ")) if first else []
    found = columns(names) if len(names) == len(rows[0].fields) and is_header(names) else Columns()
    return NamedRows(rows, found, False, delimiter)


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
    if header and rows and not is_number(rows[0].fields[0]):
        rows = rows[1:]
    values = []
    for row in rows:
        n = len(row.fields)
        if n < columns or (exact and n > columns):
            raise DatasetError(f"the row has {n} values, expected {columns}: {expected}", path, line=row.line)
        values.append(parse_floats(row, row.fields[:columns], path, expected))
    return np.array(values, dtype=np.float64).reshape(-1, columns), [row.line for row in rows]


def is_number(text: str) -> bool:
    """Whether a field of a table is a number."""
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


def read_tum(path: Path, unit_s: float | None = None) -> Trajectory:
    """TUM: ``time x y z qx qy qz qw`` per line, ``#`` comments; commas and a header are taken, too.

    Where the header names the columns they are read by name. ``unit_s``: seconds in a unit of its times; None: as the
    header says, else seconds unless they are too far apart. Raises DatasetError with file:line.
    """
    return _read_posed(path, read_named_rows(path), "time x y z qx qy qz qw", 1.0, unit_s)


def is_tum(path: Path) -> bool:
    """Whether the first row has the eight numbers of a TUM file; False for what cannot be read."""
    try:
        rows = read_named_rows(path).rows
        return bool(rows) and len(rows[0].fields) == 8 and all(is_number(text) for text in rows[0].fields)
    except DatasetError:
        return False


def read_tum_ns(path: Path, unit_s: float | None = None) -> Trajectory:
    """TUM in nanoseconds, as ORB-SLAM3 writes; of a frame that is there twice the second line counts."""
    table, lines = read_table(path, 8, "time in ns, x y z qx qy qz qw", exact=True)
    last = np.append(np.diff(table[:, 0]) != 0, True)[: len(table)]
    table, lines = table[last], [line for line, keep in zip(lines, last) if keep]
    times = table[:, 0] * (unit_s or 1e-9)
    check_times(times, path, lines)
    return Trajectory(times, poses_from_rows(table[:, 1:8], path, lines))


def read_pose_csv(path: Path, unit_s: float | None = None) -> Trajectory:
    """A table of poses by its header. Without one, times in nanoseconds make it EuRoC's (qw first), others TUM's."""
    table = read_named_rows(path)
    nanoseconds = False
    if table.rows and table.columns.quaternion is None:
        stamps = np.array([parse_floats(row, row.fields[:1], path, "time")[0] for row in table.rows])
        nanoseconds = (unit_s or time_unit(stamps, 1.0)) == 1e-9
    if nanoseconds or (table.rows and len(table.rows[0].fields) > 8):
        return _read_posed(path, table, _EUROC, 1e-9, unit_s)
    return _read_posed(path, table, "time, x, y, z, qx, qy, qz, qw", 1.0, unit_s)


_EUROC = "time in ns, x, y, z, qw, qx, qy, qz"
_DEFAULT_COLUMNS = Columns(time=0, position=(1, 2, 3), quaternion=(4, 5, 6, 7))
_EUROC_COLUMNS = Columns(time=0, position=(1, 2, 3), quaternion=(5, 6, 7, 4))


def read_euroc_csv(path: Path, unit_s: float | None = None) -> Trajectory:
    """EuRoC ground truth: ``time[ns], x, y, z, qw, qx, qy, qz, ...`` with commas; further columns are ignored.

    Where the header names the columns they are read by name. Raises DatasetError with file:line.
    """
    return _read_posed(path, read_named_rows(path), _EUROC, 1e-9, unit_s)


def _read_posed(
    path: Path, table: NamedRows, expected: str, unit_s: float, forced_s: float | None = None
) -> Trajectory:
    """Poses of a table: by name, or as ``expected`` says for one without names; TUM has no further columns then.

    ``forced_s``: seconds that a unit of the time stands for, whatever the table says.
    """
    if not table.rows:
        raise DatasetError("the trajectory has no pose", path)
    where = table.columns
    if where.position is None or where.quaternion is None or where.time is None:
        if table.written:
            wanted = {"time": where.time, "position (x, y, z)": where.position, "quaternion": where.quaternion}
            missing = " and no ".join(name for name, place in wanted.items() if place is None)
            raise DatasetError(f"the header names no {missing}; expected are names such as {expected}", path)
        where = _EUROC_COLUMNS if expected == _EUROC else _DEFAULT_COLUMNS
    exact = where is _DEFAULT_COLUMNS and expected != _EUROC
    assert where.time is not None
    assert where.position is not None
    assert where.quaternion is not None
    stamp = [where.time] if where.nanoseconds is None else [where.time, where.nanoseconds]
    chosen = [*where.position, *where.quaternion]
    need = 8 if exact else max(*stamp, *chosen) + 1
    values = []
    for row in table.rows:
        n = len(row.fields)
        if n < need or (exact and n > need):
            raise DatasetError(f"the row has {n} values, expected {need}: {expected}", path, line=row.line)
        values.append(parse_floats(row, [row.fields[k] for k in (*stamp, *chosen)], path, expected))
    found, lines = np.array(values), [row.line for row in table.rows]
    fresh = np.append(True, (found[1:] != found[:-1]).any(axis=1))  # a pose recorded twice is one pose
    found, lines = found[fresh], [line for line, keep in zip(lines, fresh) if keep]
    unit = forced_s or where.unit_s or time_unit(found[:, 0], unit_s)
    times = found[:, 0] * unit if where.nanoseconds is None else found[:, 0] + 1e-9 * found[:, 1]
    check_times(times, path, lines)
    rows = found[:, len(stamp) :]
    rows[:, :3] *= where.position_m
    return Trajectory(times, poses_from_rows(rows, path, lines))


#: Readers of tables by kind. Each takes a file, and seconds in a unit of its times if they are not as the kind says.
READERS: dict[str, Callable[..., Trajectory]] = {
    "tum": read_tum,
    "tum-ns": read_tum_ns,
    "euroc": read_euroc_csv,
    "csv": read_pose_csv,
}


def time_unit(stamps: Array, default: float, fastest: float = 2e-3) -> float:
    """Seconds that a unit of ``stamps`` (N,) stands for, by the distance between them; ``default`` where that may be.

    Samples are taken to be ``fastest`` seconds to a thousand times as long apart. Milliseconds without a date cannot be
    told from frame numbers: they stay as they are.
    """
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    largest = float(np.abs(stamps).max(initial=0.0))
    if not len(steps):
        dates = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
        return next((unit for least, unit in dates if largest > least), default)
    step = float(np.percentile(steps, 10, method="lower"))
    if step >= fastest * 1e9:
        return 1e-9
    if step >= fastest * 1e6:
        return 1e-6
    if step >= fastest * 1e3 and largest > 1e11:
        return 1e-3
    whole = bool((stamps == np.rint(stamps)).all())
    return default if default == 1.0 or (whole and step >= 1) else 1.0


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

"""Tables of inertial samples: columns by their header, or time, angular rate, specific force."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.trajectory_io import check_times, parse_floats, read_named_rows, time_unit
from panobench.errors import DatasetError
from panobench.types import Imu

EXPECTED = "time,wx,wy,wz,ax,ay,az"
#: Inertial sensors sample at up to ten kilohertz.
_FASTEST_S = 1e-4


def read_imu_table(path: Path, unit_s: float = 1.0, *, exact: bool = False) -> Imu:
    """Samples in rad/s and m/s^2, whichever units the header names. ``unit_s``: seconds in a unit of the time, unless
    its name or spacing says otherwise.

    ``exact``: a table without a header has seven columns and no more. Raises DatasetError with file:line.
    """
    table = read_named_rows(path)
    where = table.columns
    stamp, chosen = [0], [1, 2, 3, 4, 5, 6]
    named = where.time is not None and where.gyro is not None and where.accel is not None
    if where.time is not None and where.gyro is not None and where.accel is not None:
        stamp = [where.time] if where.nanoseconds is None else [where.time, where.nanoseconds]
        chosen = [*where.gyro, *where.accel]
    elif table.written:
        raise DatasetError(f"the header names no time, angular rate and acceleration; expected: {EXPECTED}", path)
    need = max(*stamp, *chosen) + 1
    values = []
    for row in table.rows:
        n = len(row.fields)
        if n < need or (exact and not named and n > need):
            raise DatasetError(f"the row has {n} values, expected {need}: {EXPECTED}", path, line=row.line)
        values.append(parse_floats(row, [row.fields[k] for k in (*stamp, *chosen)], path, EXPECTED))
    found: NDArray[np.float64] = np.array(values, dtype=np.float64).reshape(-1, len(stamp) + 6)
    if len(stamp) == 2:
        times = found[:, 0] + 1e-9 * found[:, 1]
    else:
        times = found[:, 0] * (where.unit_s or time_unit(found[:, 0], unit_s, _FASTEST_S))
    check_times(times, path, [row.line for row in table.rows])
    samples = found[:, len(stamp) :]
    return Imu(times, samples[:, :3] * where.gyro_rad_s, samples[:, 3:] * where.accel_m_s2)

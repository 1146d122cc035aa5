"""Write stand-in programs for tests of adapters: they take the command line and files of the genuine program."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

from panobench.geometry import quaternion_from_matrix
from panobench.types import Trajectory


def write_program(path: Path, code: str) -> Path:
    """An executable Python program (standard library only) at ``path``; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!{sys.executable} -IS\n{code}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def pose_rows(trajectory: Trajectory, order: str = "xyzw") -> list[tuple[float, ...]]:
    """(time, x, y, z, quaternion in ``order``) per pose, for stand-ins to print in their program's format."""
    quaternions = quaternion_from_matrix(trajectory.T_wc[:, :3, :3])
    columns = ["wxyz".index(letter) for letter in order]
    return [
        (float(t), *(float(v) for v in p), *(float(q[c]) for c in columns))
        for t, p, q in zip(trajectory.times, trajectory.positions, quaternions)
    ]

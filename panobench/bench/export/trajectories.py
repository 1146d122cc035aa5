"""The path of a run as text."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from panobench.bench.export.base import ExportOptions, poses_of
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run


def tum(run: Run, target: Path, options: ExportOptions) -> None:
    from panobench.datasets.files.trajectory_io import tum_text

    write_whole(target, tum_text(poses_of(run)))


def kitti(run: Run, target: Path, options: ExportOptions) -> None:
    """Poses, and their times beside them, as KITTI keeps them."""
    trajectory = poses_of(run)
    rows = trajectory.T_wc[:, :3].reshape(-1, 12)
    write_whole(target, "".join(" ".join(f"{v:.12e}" for v in row) + "\n" for row in rows))
    write_whole(target.with_name(f"{target.stem}.times.txt"), "".join(f"{t:.9f}\n" for t in trajectory.times))

"""Where the challenge's recordings and ground truths are, and what runs are called."""

from __future__ import annotations

import re
from pathlib import Path

from panobench.datasets.bags.layout import find_bags
from panobench.datasets.files.listing import children
from panobench.datasets.files.natural import natural_paths
from panobench.errors import DatasetError

FLOORS = ("1", "2", "3", "4", "5", "6", "7", "EG", "UG1", "UG2")
#: Names of runs and of submitted files: floor_X_YYYY-MM-DD_run_Z.
RUN_NAME = re.compile(r"floor_([A-Za-z0-9]+)_(\d{4}-\d{2}-\d{2})_run_(\d+)")


def find_runs(root: Path) -> dict[str, Path]:
    """Name -> folder of the run, in natural order: of floor_X/YYYY-MM-DD/run_Z below ``root`` or ``root``/data, or of
    ``root`` itself.
    """
    if not root.exists():
        raise DatasetError("no such file or folder", root)
    for base in (root, root / "data"):
        found = {run_name(path): path for path in _runs(base)} if base.is_dir() else {}
        if found:
            return found
    return {run_name(root): root} if find_bags(root, levels=1) else {}


def _runs(base: Path) -> list[Path]:
    days = [day for floor in _folders(base, r"floor_\w+") for day in _folders(floor, r"[\d-]+")]
    return [run for day in days for run in _folders(day, r"run_\d+")]


def _folders(base: Path, name: str) -> list[Path]:
    return natural_paths(p for p in children(base) if p.is_dir() and re.fullmatch(name, p.name))


def run_name(path: Path) -> str:
    """ "floor_1_2025-05-05_run_1" of .../floor_1/2025-05-05/run_1; the folder's own name elsewhere."""
    parts = path.resolve().parts
    if parts[-1:] == ("rosbag",) and len(parts) > 1:
        parts = parts[:-1]
    name = "_".join(parts[-3:])
    return name if RUN_NAME.fullmatch(name) else parts[-1]


def bag_of(run: Path) -> Path:
    """The bag of a run's folder. Raises DatasetError if there is none or more than one."""
    found = find_bags(run, levels=1)
    if len(found) != 1:
        raise DatasetError("no bag here: rosbag/rosbag.db3 is expected" if not found else "several bags here", run)
    return next(iter(found.values()))


def truth_of(run: Path, name: str) -> Path | None:
    """The ground truth NAME.txt: in the run's folder, or in groundtruth/ beside or above the floors; None without."""
    above = [run, *run.resolve().parents[:4]]
    places = [folder / f"{name}.txt" for folder in above] + [folder / "groundtruth" / f"{name}.txt" for folder in above]
    return next((path for path in places if path.is_file()), None)

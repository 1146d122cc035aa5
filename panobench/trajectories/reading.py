"""Finding out in which format a file holds poses, and reading it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from panobench.datasets.files import trajectory_io as io
from panobench.errors import DatasetError, InputError, UnknownNameError, UsageError
from panobench.trajectories import colmap_model, json_files, matrices
from panobench.trajectories.posed import PoseList

#: Names that `--format` takes.
FORMATS = ("tum", "tum-ns", "kitti", "euroc", "csv", "colmap", "transforms", "monogs", "matrices")
#: What `--time-unit` takes: seconds of a unit of time, None for frame numbers.
UNITS: dict[str, float | None] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "frames": None}
#: Files of a COLMAP model, for whoever names its folder.
_MODEL_FILES = ("images.bin", "images.txt")


def read_poses(path: Path, form: str | None = None, unit: str | None = None) -> PoseList:
    """The poses of a file of any known format, recognised unless ``form`` says which; a folder is a COLMAP model's.

    ``unit``: what its times count, a key of UNITS; None: as the file's header says, or by the distances between them.
    Poses are camera-to-world, unless a TUM, CSV or matrix file holds the inverse, which nothing in it tells.
    Raises DatasetError naming file and line, UsageError for a format or unit there is not.
    """
    if form is not None and form not in FORMATS:
        raise UsageError(f"--format: {UnknownNameError('format', form, FORMATS)}")
    if unit is not None and unit not in UNITS:
        raise UsageError(f"--time-unit {unit}: known are {', '.join(UNITS)}")
    if path.is_dir():
        path = _model_file(path)
    kind = form or recognise(path)
    if kind == "colmap":
        return colmap_model.read_poses(path)
    if kind in ("transforms", "monogs"):
        return json_files.read_poses(path)
    counts_frames = unit == "frames"
    unit_s = 1.0 if counts_frames else (UNITS[unit] if unit is not None else None)
    if kind in ("kitti", "matrices"):
        found = matrices.read_poses(path, unit_s)
    else:
        trajectory = io.READERS[kind](path, unit_s)
        found = PoseList(trajectory.T_wc, kind, times=trajectory.times)
    if not counts_frames or found.times is None:
        return found
    numbers = np.rint(found.times)
    if np.abs(found.times - numbers).max() > 1e-6 or not 0 <= numbers[0] <= numbers[-1] < 1 << 40:
        raise UsageError(f"--time-unit frames: {path.name} has times that are no frame numbers")
    return PoseList(found.T_wc, found.format, numbers=numbers.astype(np.int64))


def _model_file(folder: Path) -> Path:
    for place in (folder, folder / "sparse" / "0", folder / "sparse"):
        for name in _MODEL_FILES:
            if (place / name).is_file():
                return place / name
    raise DatasetError("a folder without images.bin or images.txt (COLMAP); name the trajectory's file", folder)


def recognise(path: Path) -> str:
    """The format of a file, one of FORMATS. Raises InputError for anything else."""
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except FileNotFoundError:
        raise DatasetError("the file is missing", path) from None
    except OSError as error:
        raise DatasetError(f"the file cannot be read ({error.strerror})", path) from None
    if b"\0" in head and path.suffix.lower() == ".bin":
        return "colmap"
    if head.lstrip()[:1] == b"{":
        return "monogs" if b'"trj_' in head else "transforms"
    table = io.read_named_rows(path)
    rows = table.rows
    if not rows:
        raise InputError("the trajectory has no pose", path)
    if table.delimiter is None and colmap_model.is_image_line(rows[0].fields):
        return "colmap"
    if matrices.is_matrices(table):
        return "matrices"
    if table.delimiter is not None or table.columns.quaternion is not None or table.written:
        return "csv"
    if len(rows[0].fields) == 8:
        try:
            return "tum-ns" if abs(float(rows[0].fields[0])) > 1e14 else "tum"
        except ValueError:
            pass
    raise InputError(
        f"the row has {len(rows[0].fields)} values, which no format has: TUM 8, matrices 12, 16 or four rows of 4, "
        "COLMAP's images.txt 10, tables with commas or a header any; say which with --format",
        path,
        line=rows[0].line,
    )

"""True poses in a file beside a folder of images: groundtruth.txt of TUM's RGB-D recordings and its relatives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from panobench.datasets.files.image_times import ImageTimes
from panobench.errors import PanobenchError
from panobench.trajectories.matching import Frames
from panobench.trajectories.reference import read_reference
from panobench.types import Trajectory

#: Names, without their endings, that say that the poses are true; others may be an estimate.
_NAMES = ("groundtruth", "ground_truth", "gt")
_MAYBE = ("poses", "trajectory", "traj")
_ENDINGS = (".tum", ".txt", ".csv")


@dataclass(frozen=True)
class TruthBeside:
    """Poses at the images' times, as recorded, and whether in metres; what to say of the file."""

    trajectory: Trajectory | None = None
    recorded: Trajectory | None = None
    scaled: bool = True
    files: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()


def truth_beside(folders: list[Path], taken: ImageTimes) -> TruthBeside:
    """The true poses in one of ``folders``, where their times are those of the images. Never raises: what cannot be
    used is named in a remark.
    """
    path = _first(folders, _NAMES)
    if path is None:
        other = _first(folders, _MAYBE)
        line = (
            "" if other is None else f"{other.name} beside the images is not used: --groundtruth FILE takes it as true"
        )
        return TruthBeside(remarks=(line,) if line else ())
    names = [image.name for image in taken.images]
    frames = Frames(taken.times, names, np.arange(len(names)), len(names), taken.start)
    try:
        found = read_reference(path, frames)
    except PanobenchError as error:
        return TruthBeside(remarks=(f"{path.name} beside the images is not used: {_short(error, path)}",))
    if taken.assumed and found.recorded is not None:
        line = f"{path.name} beside the images is not used: nothing says when they were taken (--rate)"
        return TruthBeside(remarks=(line,))
    remarks = (f"ground truth is from {path.name}, which lies beside the images", *found.remarks)
    return TruthBeside(found.trajectory, found.recorded, found.scaled, (path,), remarks)


def _first(folders: list[Path], names: tuple[str, ...]) -> Path | None:
    files = (folder / f"{name}{ending}" for folder in folders for name in names for ending in _ENDINGS)
    return next((file for file in files if file.is_file()), None)


def _short(error: PanobenchError, path: Path) -> str:
    return str(error).removeprefix(f"{path}: ")

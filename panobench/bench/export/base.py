"""What all export formats share: their options, and what they take from a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.errors import UsageError
from panobench.types import Trajectory

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.splat.gaussians import GaussianMap

#: Gaussians with less opacity are no points of a surface.
MIN_OPACITY = 0.5


@dataclass(frozen=True)
class ExportOptions:
    """images: the frames are read from the data again; models hold them, and a mesh's depth is put right by them.
    faces: those of panoramas as the six faces of a cube. voxel: edge of a mesh's voxels, map units; None chooses.
    camera: of a film, "erp" or "pinhole:DEGREES". width: of a film or a face, or of the frames read
    for a mesh, pixels; None chooses, for a mesh the run's. seconds: length of a film.
    """

    images: bool = True
    faces: bool = False
    voxel: float | None = None
    camera: str = "erp"
    width: int | None = None
    seconds: float = 10.0


@dataclass(frozen=True)
class ExportFormat:
    """A format: what it is, where it goes by default (a file, or a folder with "/" at its end), and its writer."""

    about: str
    default: str
    write: Callable[[Run, Path, ExportOptions], None]


def poses_of(run: Run) -> Trajectory:
    """The trajectory. Raises UsageError where no frame has a pose."""
    if not len(run.trajectory):
        raise UsageError(f"{run.folder} has no poses to export")
    return run.trajectory


def map_of(run: Run) -> GaussianMap:
    """The Gaussians. Raises UsageError without a map."""
    if run.map is None or not len(run.map):
        raise UsageError(f"{run.folder} has no map to export")
    return run.map


def opacities(gaussians: GaussianMap) -> NDArray[np.float64]:
    """(N,) in 0..1."""
    return 1.0 / (1.0 + np.exp(-np.asarray(gaussians.opacity_logits, np.float64)))


def opaque_points(run: Run) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Centres (N, 3) and colours (N, 3) of the opaque Gaussians of its map; none without a map."""
    gaussians = run.map
    if gaussians is None:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    centres = np.asarray(gaussians.means, np.float32)
    keep = (opacities(gaussians) > MIN_OPACITY) & np.isfinite(centres).all(axis=1)
    colours = np.clip(np.asarray(gaussians.colours)[keep], 0.0, 1.0)
    return centres[keep], np.rint(255.0 * colours).astype(np.uint8)

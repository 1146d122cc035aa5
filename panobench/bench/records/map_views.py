"""A stored map as a sequence of panoramas rendered from it, so that whatever shows sequences shows maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.runfolder import MAP, RUN_JSON, TRAJECTORY
from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_io import read_tum
from panobench.errors import InputError
from panobench.splat.gaussians import GaussianMap
from panobench.splat.ply import read_ply
from panobench.splat.render import Renderer
from panobench.types import Trajectory

WIDTH = 1024


def is_map(source: Path) -> bool:
    """Whether ``source`` is a PLY file or the folder of a run."""
    return (source.is_file() and source.suffix.lower() == ".ply") or (source / RUN_JSON).is_file()


class MapSequence(FrameSequence):
    """The map seen from the poses of its run; from the origin of its world where there are none beside it.

    gaussians: the map. poses (N, 4, 4): camera-to-world.

    Methods begin their world at the first camera. Raises InputError for a file that is no map of Gaussians, and for a
    run without one.
    """

    def __init__(self, source: Path, camera: Camera | None = None) -> None:
        path = source / MAP if source.is_dir() else source
        if not path.is_file():
            raise InputError("the run has no map", source)
        self.gaussians = GaussianMap(*read_ply(path))
        poses = path.parent / TRAJECTORY
        beside = path.name == MAP and poses.is_file() and poses.stat().st_size > 0
        trajectory = read_tum(poses) if beside else Trajectory(np.zeros(1), np.eye(4)[None])
        self.name = path.parent.resolve().name + "-map" if path.name == MAP else path.stem
        self.dataset, self.times, self.poses = "map", trajectory.times, trajectory.T_wc
        self.camera = camera or ErpCamera(WIDTH, WIDTH // 2)
        self._renderer = Renderer(self.camera)

    def __len__(self) -> int:
        return len(self.times)

    def image(self, index: int) -> NDArray[np.uint8]:
        colour = self._renderer.forward(self.gaussians, self.poses[index]).colour
        return np.ascontiguousarray(np.rint(255.0 * np.clip(np.nan_to_num(colour), 0.0, 1.0)).astype(np.uint8))

    def frame_name(self, index: int) -> str:
        return f"pose {index}"

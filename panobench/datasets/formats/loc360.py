"""360Loc: 360 images of four places with poses, made for visual localisation.

Huang et al., "360Loc: A Dataset and Benchmark for Omnidirectional Visual Localization with Cross-device Queries"
(CVPR 2024). Layout: ``PLACE/{mapping,query_360}/SEQUENCE/image/*.jpg`` with ``camera_pose.json`` beside ``image/``:
image name -> 4x4 camera-to-world in x right, y down, z forward. There are no times: frames are one second apart.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import list_images
from panobench.datasets.files.json_poses import read_json, rigid_matrix
from panobench.datasets.files.natural import natural_names, natural_paths
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.formats.synpano import panorama_camera
from panobench.datasets.found import FoundSequences
from panobench.errors import DatasetError
from panobench.types import Trajectory

_POSES = "camera_pose.json"


class Loc360(FoundSequences):
    """Sequences are named PLACE/mapping/NAME and PLACE/query_360/NAME below ``root``, or ``root`` is one."""

    name = "360loc"

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset '360loc' needs --root PATH")
        if (self.root / _POSES).is_file():
            return {self.root.resolve().name: self.root}
        files = [p for k in range(1, 4) for p in self.root.glob("*/" * k + _POSES)]
        found = {p.parent.relative_to(self.root).as_posix(): p.parent for p in natural_paths(files) if _is_360(p)}
        if not found:
            raise DatasetError(f"no 360Loc sequence here: PLACE/mapping/NAME/{_POSES} is expected", self.root)
        return found

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        return ImageSequence(_read(place, name), width)


def _is_360(path: Path) -> bool:
    """Not one of the pinhole and fisheye queries cut out of the panoramas."""
    return not any(k in part for part in path.parts for k in ("query_pinhole", "query_fisheye"))


def _read(folder: Path, name: str) -> ImageSource:
    path = folder / _POSES
    table = read_json(path)
    if not isinstance(table, dict) or not table:
        raise DatasetError("expected image names with their poses", path)
    images = folder / "image"
    present = {p.name: p for p in list_images(images)}
    names = natural_names(table)
    missing = [n for n in names if n not in present]
    if missing:
        raise DatasetError(f"image '{missing[0]}' is missing in {images}", path)
    files = [present[n] for n in names]
    times = np.arange(len(files), dtype=np.float64)
    poses = np.stack([rigid_matrix(table[n], path, f"'{n}'") for n in names])
    return ImageSource(
        dataset="360loc",
        name=name,
        root=folder,
        native=panorama_camera(check_sizes(files[:1]), files[0]),
        times=times,
        images=files,
        groundtruth=Trajectory(times, poses),
        inputs=(path,),
        notes={"times": "frame numbers: the data set has none"},
    )

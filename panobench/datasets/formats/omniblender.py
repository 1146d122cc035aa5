"""OmniBlender and OB3D: synthetic 360 scenes rendered with Blender.

OmniBlender (Choi et al., "Balanced Spherical Grid for Egocentric View Synthesis", CVPR 2023): ``SCENE/images/*.png``
and ``SCENE/transform.json`` with frames {file_path, transform_matrix}, camera-to-world in Blender's camera axes.
OB3D (Ito et al., "OB3D", 2025): ``SCENE/{Egocentric,Non-Egocentric}/images/NNNNN_rgb.png`` and
``cameras/NNNNN_cam.json`` with world-to-camera rotation and translation in x right, y down, z forward; its EXR
depth is not read. Neither has times: frames are one second apart,
in the order of the numbers in the images' names,
or of transform.json where the names are not numbered alike.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import IMAGE_SUFFIXES, list_images
from panobench.datasets.files.json_poses import read_json, rigid, rigid_matrix
from panobench.datasets.files.listing import visible
from panobench.datasets.files.natural import natural_key, natural_names, natural_paths, same_but_for_numbers
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.formats.synpano import panorama_camera, raw_to_camera_axes
from panobench.datasets.found import FoundSequences
from panobench.errors import DatasetError
from panobench.geometry import invert_pose
from panobench.types import Trajectory

_TRANSFORMS = "transform.json"


class OmniBlender(FoundSequences):
    """Scenes of either data set below ``root``, or ``root`` itself is one."""

    name = "omniblender"

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset 'omniblender' needs --root PATH")
        if _is_scene(self.root):
            return {self.root.resolve().name: self.root}
        folders = [p for k in (1, 2) for p in natural_paths(self.root.glob("*/" * (k - 1) + "*")) if visible(p)]
        found = {p.relative_to(self.root).as_posix(): p for p in folders if p.is_dir() and _is_scene(p)}
        if not found:
            raise DatasetError(
                f"no scene here: SCENE/{_TRANSFORMS} (OmniBlender) or SCENE/Egocentric/cameras/ (OB3D) is expected",
                self.root,
            )
        return {name: found[name] for name in sorted(found, key=natural_key)}

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        return ImageSequence(_read(place, name), width)


def _is_scene(folder: Path) -> bool:
    return (folder / _TRANSFORMS).is_file() or ((folder / "cameras").is_dir() and (folder / "images").is_dir())


def _read(folder: Path, name: str) -> ImageSource:
    if (folder / _TRANSFORMS).is_file():
        images, poses, inputs = _read_transforms(folder)
    else:
        images, poses, inputs = _read_ob3d(folder)
    if not images:
        raise DatasetError("the sequence is empty", folder)
    times = np.arange(len(images), dtype=np.float64)
    return ImageSource(
        dataset="omniblender",
        name=name,
        root=folder,
        native=panorama_camera(check_sizes(images[:1]), images[0]),
        times=times,
        images=images,
        groundtruth=Trajectory(times, np.stack(poses)),
        inputs=tuple(inputs),
        notes={"times": "frame numbers: the data set has none"},
    )


def _read_transforms(folder: Path) -> tuple[list[Path], list[Any], list[Path]]:
    path = folder / _TRANSFORMS
    content = read_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise DatasetError("expected 'frames', a list", path)
    present = {p.name: p for p in list_images(folder / "images")}
    found = {}
    for k, frame in enumerate(frames):
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str):
            raise DatasetError("a frame has no 'file_path'", path, frame=k)
        file = next((present[n] for n in (name, *(name + s for s in IMAGE_SUFFIXES)) if n in present), None)
        if file is None:
            raise DatasetError(f"image '{name}' is missing in {folder / 'images'}", path, frame=k)
        pose = rigid_matrix(frame.get("transform_matrix"), path, f"'{name}'")
        found[file.name] = (file, raw_to_camera_axes(pose))
    order = natural_names(found) if same_but_for_numbers(found) else found
    return [found[n][0] for n in order], [found[n][1] for n in order], [path]


def _read_ob3d(folder: Path) -> tuple[list[Path], list[Any], list[Path]]:
    images = list_images(folder / "images")
    poses, inputs = [], []
    for k, image in enumerate(images):
        path = folder / "cameras" / f"{image.stem.removesuffix('_rgb')}_cam.json"
        content = read_json(path)
        camera = content[0] if isinstance(content, list) and content else content
        extrinsics = camera.get("extrinsics") if isinstance(camera, dict) else None
        if not isinstance(extrinsics, dict):
            raise DatasetError("expected 'extrinsics' with rotation and translation", path, frame=k)
        T_cw = rigid(extrinsics.get("rotation"), extrinsics.get("translation"), path, f"'{image.name}'")
        poses.append(invert_pose(T_cw))
        inputs.append(path)
    return images, poses, inputs

"""Images with poses of other programs' reconstructions: projects of COLMAP and of nerfstudio.

COLMAP: ``ROOT/images/`` and a model (``cameras`` and ``images``, .bin or .txt) in ``ROOT/sparse/0``, ``ROOT/sparse``
or ROOT. nerfstudio, instant-ngp: ``ROOT/transforms.json`` and the images that it names. The poses are the ground truth,
without scale.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path, PurePosixPath

import numpy as np

from panobench.cameras.alike import middle_camera, middle_remark, sample
from panobench.cameras.base import Camera
from panobench.cameras.calibration import inspect_calibration
from panobench.cameras.calibration.colmap import read_cameras
from panobench.cameras.calibration.nerfstudio import camera_of as nerfstudio_camera
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.files.image_times import image_times
from panobench.datasets.files.images import IMAGE_SUFFIXES, list_images
from panobench.datasets.files.json_poses import read_json
from panobench.datasets.files.natural import natural_paths
from panobench.datasets.formats.image_folder import for_size
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.locate import choose_sequence
from panobench.errors import DatasetError
from panobench.reading import inside
from panobench.trajectories.colmap_model import read_images
from panobench.trajectories.json_files import transforms
from panobench.types import Trajectory

#: Where COLMAP's programs put a model, and where people put their images.
_MODELS, _IMAGES = (
    (".", "sparse/0", "sparse", "colmap/sparse/0"),
    ("images", "input", "rgb", "../images", "../../images", "."),
)
TRANSFORMS = ("transforms.json", "transforms_train.json")


class _Posed(Dataset):
    """One sequence: the project itself."""

    takes = frozenset({"rate", "calibration"})

    def sequences(self) -> list[str]:
        return [self._at().resolve().name]

    def _at(self) -> Path:
        if self.root is None:
            raise DatasetError(f"dataset '{self.name}' needs --root FOLDER")
        if not self.root.exists():
            raise DatasetError("no such file or folder", self.root)
        return self.root

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name = choose_sequence(self.name, sequence, self.sequences())
        return ImageSequence(self._read(name), width)

    def _read(self, name: str) -> ImageSource:
        raise NotImplementedError

    def _source(
        self, name: str, images: dict[Path, np.ndarray | None], camera: Camera, inputs: list[Path], remarks: list[str]
    ) -> ImageSource:
        """A sequence of images and, where they have one, their poses."""
        taken = image_times(natural_paths(images), self.given.rate)
        size = check_sizes(taken.images)
        posed = [i for i, path in enumerate(taken.images) if images[path] is not None]
        T_wc = np.stack([images[taken.images[i]] for i in posed])  # type: ignore[misc]
        said = [taken.source] if taken.assumed else [f"times are from {taken.source}"]
        return ImageSource(
            dataset=self.name,
            name=name,
            root=self._at(),
            native=for_size(camera, size, inputs[0]),
            times=taken.times,
            images=taken.images,
            groundtruth=Trajectory(taken.times[posed], T_wc),
            groundtruth_scaled=False,
            inputs=(*inputs, *taken.inputs),
            notes={"times": taken.source},
            remarks=(*said, *remarks),
        )


def colmap_model(root: Path) -> tuple[Path, Path] | None:
    """cameras and images file of the model that belongs to ``root``, None if there is none."""
    for place in _MODELS:
        for ending in (".bin", ".txt"):
            files = root / place / f"cameras{ending}", root / place / f"images{ending}"
            if all(file.is_file() for file in files):
                return files
    return None


class ColmapProject(_Posed):
    """A COLMAP project, or a model's folder in one."""

    name = "colmap"

    def _read(self, name: str) -> ImageSource:
        root = self._at()
        model = colmap_model(root)
        if model is None:
            raise DatasetError(
                "no COLMAP model here: cameras and images (.bin or .txt) in it, sparse/ or sparse/0/", root
            )
        found = read_images(model[1])
        number, count = Counter(found.cameras).most_common(1)[0]
        remarks: list[str] = []
        camera = None
        if count < len(found.cameras) and not _one_camera(model[0]):
            camera, remarks = _middle_of(model[0], set(found.cameras))
        if count < len(found.cameras) and camera is None and not _one_camera(model[0]):
            remarks.append(
                f"of the model's cameras number {number} is taken: it has {count} of {len(found.cameras)} images"
            )
            chosen = [k for k, camera in enumerate(found.cameras) if camera == number]
        else:
            chosen = list(range(len(found.names)))
        folder = _image_folder(root, [found.names[k] for k in chosen], model[1])
        images: dict[Path, np.ndarray | None] = {}
        for k in chosen:
            file = inside(folder, found.names[k])
            if file is not None and file.is_file():
                images[file] = found.T_wc[k]
        missing = len(chosen) - len(images)
        if missing:
            remarks.append(f"{missing} of {len(chosen)} registered images are missing in {folder}")
        for other in {file.parent for file in images}:
            images |= {file: None for file in list_images(other) if file not in images}
        if camera is None or self.given.calibration is not None:
            camera = inspect_calibration(self.given.calibration or f"{model[0]}#{number}").camera
        return self._source(name, images, camera, list(model), remarks)


def _one_camera(path: Path) -> bool:
    """Whether all cameras of the file are the same, as COLMAP makes one for every image unless told otherwise."""
    return len({entry[1:] for entry in read_cameras(path).values()}) == 1


def _middle_of(path: Path, used: set[int]) -> tuple[Camera | None, list[str]]:
    """One camera for images that have cameras of their own, as COLMAP makes them, and what to say of it."""
    entries = {entry[1:]: entry for number, entry in read_cameras(path).items() if int(number) in used}
    found = middle_camera([entry.camera(path) for entry in sample(list(entries.values()))])
    return (None, []) if found is None else (found[0], [middle_remark(found[1])])


def _image_folder(root: Path, names: list[str], model: Path) -> Path:
    """The folder that the names in a model start from. Raises DatasetError."""
    for base in (root, model.parent):
        for place in _IMAGES:
            folder = base / place
            file = inside(folder, names[0])
            if file is not None and file.is_file():
                return folder
    raise DatasetError(f"the image '{names[0]}' of the model is missing; images/ beside the model is expected", root)


class NerfstudioProject(_Posed):
    """A folder with transforms.json, or that file itself."""

    name = "nerfstudio"

    def _at(self) -> Path:
        root = super()._at()
        return root.parent if root.is_file() else root

    def _read(self, name: str) -> ImageSource:
        root = self._at()
        path = self.root if self.root is not None and self.root.is_file() else None
        path = path or next((root / n for n in TRANSFORMS if (root / n).is_file()), None)
        if path is None:
            raise DatasetError("no transforms.json here", root)
        values = read_json(path)
        if not isinstance(values, dict) or not isinstance(values.get("frames"), list):
            raise DatasetError("expected 'frames', a list", path)
        names, T_wc = transforms(values, path)
        images: dict[Path, np.ndarray | None] = {}
        missing = None
        for file_name, T in zip(names, T_wc):
            file = _named(root, file_name)
            if file is None:
                missing = missing or file_name
                continue
            if file in images:
                raise DatasetError(f"'{file_name}' is there twice", path)
            images[file] = T
        if not images:
            raise DatasetError(f"the image '{missing}' is missing, and so are all others", path)
        remarks = (
            [f"{len(names) - len(images)} of {len(names)} images are missing, '{missing}' first"] if missing else []
        )
        if self.given.calibration is not None:
            camera = inspect_calibration(self.given.calibration).camera
        else:
            camera, said = nerfstudio_camera(values, path, check_sizes(list(images)))
            remarks += said
        return self._source(name, images, camera, [path], remarks)


def _named(root: Path, name: str) -> Path | None:
    """The image that a frame names, with an ending or without."""
    name = str(PurePosixPath(name.replace("\\", "/")))
    for ending in ("", *IMAGE_SUFFIXES):
        file = inside(root, name + ending)
        if file is not None and file.is_file():
            return file
    return None

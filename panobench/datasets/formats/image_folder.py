"""A folder of images, without anything that describes it: panoramas, or what a given calibration took.

``ROOT/*.jpg``, ``ROOT/images/*.jpg``, or several folders of images below ROOT, which are its sequences, as are the
cameras whose images share a folder (``cameras_in_names``). Times: see ``image_times``. The camera: ``--calibration``,
else a calibration file beside the images, else a full panorama. True poses: ``truth_beside``.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from panobench.cameras.base import Camera
from panobench.cameras.calibration import inspect_calibration, is_calibration, split_choice
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.cameras_in_names import by_camera
from panobench.datasets.files.image_times import image_times
from panobench.datasets.files.images import list_images
from panobench.datasets.files.listing import children, one_of_each
from panobench.datasets.files.truth_beside import truth_beside
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.found import FoundSequences
from panobench.datasets.given import Given
from panobench.errors import CalibrationError, DatasetError, UsageError
from panobench.layouts.layout import Layout
from panobench.layouts.reader import mask_of_panorama, panorama_of_images
from panobench.masks.files import looks_like_mask, mask_of_folder

#: Calibration files that are looked for beside images, without their endings.
_NAMES = ("camera", "calibration", "calib", "camera_info", "intrinsics")
_ENDINGS = (".yaml", ".yml", ".xml", ".json", ".txt")
#: Folders of pictures that are no frames.
_NOT_FRAMES = {
    *("depth", "depths", "depth_images", "mask", "masks", "labels", "semantic", "semantics", "segmentation"),
    *("normals", "thumbnails", "thumbs", "previews"),
}


class ImageFolder(FoundSequences):
    """Images below ``root``; ``--rate`` and ``--calibration`` say what the files do not."""

    name = "images"
    takes = frozenset({"rate", "calibration", "layout"})

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset 'images' needs --root FOLDER")
        found = image_folders(self.root)
        if not found:
            raise DatasetError("no images here, nor in a folder below", self.root)
        return {
            name: folder
            for place, folder in found.items()
            for name in [f"{place}/{camera}" for camera in by_camera(_frames(folder))] or [place]
        }

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        return ImageSequence(self._read(place, name), width)

    def _read(self, folder: Path, name: str) -> ImageSource:
        images, others = _of_one_camera(_frames(folder), name)
        taken = image_times(one_of_each(images), self.given.rate)
        size = check_sizes(taken.images)
        camera, inputs, said, layout = camera_of(taken.images, size, self.given)
        mask = mask_of_panorama(
            partial(mask_of_folder, [folder, folder.parent]), layout or Layout(), size, (camera.width, camera.height)
        )
        truth = truth_beside([folder, folder.parent], taken)
        remarks = [*others, taken.source if taken.assumed else f"times are from {taken.source}"]
        return ImageSource(
            dataset=self.name,
            name=name,
            root=folder,
            native=mask.on(camera),
            times=taken.times,
            images=taken.images,
            groundtruth=truth.trajectory,
            groundtruth_scaled=truth.scaled,
            recorded_truth=truth.recorded,
            inputs=(*taken.inputs, *inputs, *truth.files, *mask.files()),
            notes={"times": taken.source, **mask.about()},
            remarks=(*remarks, *said, *truth.remarks, *mask.remarks),
            start_time=taken.start,
            layout=layout,
            stored=size,
        )


def _frames(folder: Path) -> list[Path]:
    return [path for path in list_images(folder) if not looks_like_mask(path)]


def _of_one_camera(images: list[Path], name: str) -> tuple[list[Path], list[str]]:
    """Of a folder's images those of the sequence ``name``, and what to say of its other cameras."""
    cameras = by_camera(images)
    if not cameras:
        return images, []
    chosen = name.rpartition("/")[2]
    line = f"the folder has images of {len(cameras)} cameras ({', '.join(cameras)}); these are of {chosen} (--sequence)"
    return cameras[chosen], [line]


def image_folders(root: Path) -> dict[str, Path]:
    """Sequence name -> folder with images: ``root`` itself, its ``images``, or folders below; the deeper ones only
    where there are none nearer.

    Folders of depth maps, masks and thumbnails are none if there are others.
    """
    found: dict[str, Path] = {}
    for levels in (2, 4):
        found = _image_folders(root, levels)
        frames = {name: folder for name, folder in found.items() if folder.name.lower() not in _NOT_FRAMES}
        if frames:
            return frames
    return found


def _image_folders(root: Path, levels: int) -> dict[str, Path]:
    if not root.is_dir():
        raise DatasetError("a folder of images is expected, this is a file", root)
    if not os.access(root, os.R_OK | os.X_OK):
        return {}
    name = root.resolve().name or "images"
    if list_images(root):
        return {name: root}
    if list_images(root / "images"):
        return {name: root / "images"}
    found: dict[str, Path] = {}
    for child in children(root):
        if child.is_dir() and levels > 0:
            below = _image_folders(child, levels - 1)
            for inner, folder in below.items():
                found[inner if folder in (child, child / "images") else f"{child.name}/{inner}"] = folder
    return found


Taken = tuple[Camera, tuple[Path, ...], tuple[str, ...], Layout | None]


def camera_of(images: list[Path], size: tuple[int, int], given: Given) -> Taken:
    """What took images of ``size`` (w, h), the files that say so, remarks, and how panoramas lie in them."""
    remark: tuple[str, ...] = ()
    calibration = given.calibration
    if calibration is None:
        files = [file for place in images[0].parents[:2] for file in _calibrations_beside(place)]
        beside = next((file for file in files if is_calibration(file)), None)
        if beside is None or given.layout is not None:
            camera, inputs, said, layout = _panorama(images, size, given.layout)
            strange = [f"{file.name} beside the images is no calibration that is read" for file in files]
            return camera, inputs, (*said, *strange), layout
        calibration = str(beside)
        remark = (f"the camera is from {beside.name}, which lies beside the images",)
    if given.layout is not None:
        raise UsageError("--layout and --calibration exclude each other: both say what took the images")
    path, _ = split_choice(calibration)
    return for_size(inspect_calibration(calibration).camera, size, path), (path,), remark, None


def calibration_beside(folder: Path) -> Path | None:
    """A file in ``folder`` whose name says that it is the camera's calibration."""
    return next(iter(_calibrations_beside(folder)), None)


def _calibrations_beside(folder: Path) -> list[Path]:
    names = (folder / f"{name}{ending}" for name in _NAMES for ending in _ENDINGS)
    return [path for path in names if path.is_file()]


def _panorama(images: list[Path], size: tuple[int, int], option: str | None) -> Taken:
    """A full panorama, or what the images hold in another layout."""
    camera, layout = panorama_of_images(images, size, option)
    return camera, (), (layout.remark,) if layout is not None and layout.remark else (), layout


def for_size(camera: Camera, size: tuple[int, int], path: Path) -> Camera:
    """A camera for images of ``size``: itself, or scaled where they were only resized. Raises CalibrationError."""
    if (camera.width, camera.height) == size:
        return camera
    if abs(camera.width * size[1] - camera.height * size[0]) <= max(camera.width, camera.height):
        scaled = camera.scaled(size[0])
        if (scaled.width, scaled.height) == size:
            return scaled
    raise CalibrationError(
        f"the calibration is for {camera.width}x{camera.height} images, these are {size[0]}x{size[1]}", path
    )

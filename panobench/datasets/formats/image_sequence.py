"""A sequence whose frames are image files: what synpano, folder and the EuRoC-like layouts share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.checksums import files_provenance
from panobench.datasets.files.images import read_depth, read_image, read_size, resize_depth, resize_image
from panobench.errors import CalibrationError, DatasetError, UsageError
from panobench.layouts.layout import Layout
from panobench.types import Imu, NovelView, Trajectory


@dataclass(frozen=True)
class ImageSource:
    """The files behind an ``ImageSequence``.

    native: camera of the stored images. depth: frame index -> depth file. inputs: further files read (ground truth,
    calibration), for the checksums. up: against gravity in the ground truth's world, where that is known. remarks: see
    ``FrameSequence.remarks``. novel: reads the novel views, full size. layout: how panoramas lie in images of the size
    ``stored`` (width, height); None: ``native`` took them as they are.
    """

    dataset: str
    name: str
    root: Path
    native: Camera
    times: NDArray[np.float64]
    images: list[Path]
    groundtruth: Trajectory | None = None
    groundtruth_scaled: bool = True
    recorded_truth: Trajectory | None = None
    up: tuple[float, float, float] | None = None
    imu: Imu | None = None
    depth: Mapping[int, Path] = field(default_factory=dict)
    inputs: tuple[Path, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    novel: Callable[[], list[NovelView]] | None = None
    start_time: float = 0.0
    layout: Layout | None = None
    stored: tuple[int, int] | None = None


def check_sizes(images: list[Path], expected: tuple[int, int] | None = None) -> tuple[int, int]:
    """The (width, height) that all images share, from their headers. Raises DatasetError naming the odd frame."""
    size = expected
    for index, path in enumerate(images):
        found = read_size(path, frame=index)
        if size is None:
            size = found
        elif found != size:
            other, cure = ("the camera", "") if expected else ("the first image", "; keep those of one size here")
            raise DatasetError(
                f"the image is {found[0]}x{found[1]} pixels, {other} is {size[0]}x{size[1]}{cure}", path, frame=index
            )
    if size is None:
        raise DatasetError("the sequence is empty: it has no image")
    return size


def is_full_panorama(camera: Camera) -> bool:
    """An ERP image that closes around the horizon: its left and right borders are neighbours."""
    if camera.kind != "erp":
        return False
    left = camera.unproject(np.array([0.0, camera.height / 2]))
    right = camera.unproject(np.array([float(camera.width), camera.height / 2]))
    return bool(np.allclose(left, right, atol=1e-6))


def scaled_camera(native: Camera, width: int | None) -> Camera:
    """``native`` at another width (None: as it is). Raises UsageError if the model cannot be that wide."""
    if width is None or width == native.width:
        return native
    try:
        return native.scaled(width)
    except CalibrationError as error:
        raise UsageError(f"--width {width}: {error}") from None


class ImageSequence(FrameSequence):
    """Frames decoded from files on demand and resized to the camera's width. Reading is thread-safe."""

    def __init__(self, source: ImageSource, width: int | None = None) -> None:
        self._stored = source.stored or (source.native.width, source.native.height)
        check_sizes(source.images, self._stored)
        self.source = source
        self.name, self.dataset, self.times = source.name, source.dataset, source.times
        self.camera = scaled_camera(source.native, width)
        self._wrap = is_full_panorama(source.native)

    def image(self, index: int) -> NDArray[np.uint8]:
        path = self.source.images[index]
        image = read_image(path, frame=index)
        expected = self._stored
        if image.shape[1::-1] != expected:
            raise DatasetError(
                f"the image is {image.shape[1]}x{image.shape[0]} pixels, the sequence is {expected[0]}x{expected[1]}",
                path,
                frame=index,
            )
        size, layout = (self.camera.width, self.camera.height), self.source.layout
        if layout is None:
            return resize_image(image, *size)
        return layout.unpack(resize_image(image, *layout.picture_size(expected, size)), size)

    @property
    def enlargement(self) -> float:
        return max(1.0, self.camera.width / self.source.native.width)

    @property
    def start_time(self) -> float:
        return self.source.start_time

    def frame_name(self, index: int) -> str:
        return self.source.images[index].name

    def depth(self, index: int) -> NDArray[np.float32] | None:
        path = self.source.depth.get(range(len(self))[index])
        if path is None:
            return None
        depth = read_depth(path, frame=index)
        if abs(depth.shape[1] * self.camera.height - depth.shape[0] * self.camera.width) > max(depth.shape):
            raise DatasetError(
                f"the depth map is {depth.shape[1]}x{depth.shape[0]} pixels: not the images' proportions",
                path,
                frame=index,
            )
        return resize_depth(depth, self.camera.width, self.camera.height, wrap=self._wrap)

    @property
    def groundtruth(self) -> Trajectory | None:
        return self.source.groundtruth

    @property
    def groundtruth_scaled(self) -> bool:
        return self.source.groundtruth_scaled

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self.source.recorded_truth

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return None if self.source.up is None else np.array(self.source.up)

    @property
    def imu(self) -> Imu | None:
        return self.source.imu

    def novel_views(self) -> list[NovelView]:
        if self.source.novel is None:
            return []
        views = self.source.novel()
        if self.camera is self.source.native:
            return views
        size = (self.camera.width, self.camera.height)
        return [NovelView(v.name, resize_image(v.image, *size), self.camera, v.T_wc) for v in views]

    def remarks(self) -> list[str]:
        return [*self.source.remarks]

    def provenance(self) -> dict[str, Any]:
        s = self.source
        return {
            "dataset": s.dataset,
            "sequence": s.name,
            "root": str(s.root),
            "native_size": [s.native.width, s.native.height],
            **files_provenance([*s.inputs, *s.images]),
            **s.notes,
        }

"""An image file, or any dataset at a path, as a sequence, for `panobench view`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import calibration_file
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import IMAGE_SUFFIXES, read_image, read_size
from panobench.datasets.given import Given
from panobench.datasets.inspection.guess import guess
from panobench.datasets.open import open_sequence
from panobench.errors import DatasetError, UnknownNameError, UsageError
from panobench.layouts.layout import Layout
from panobench.layouts.reader import panorama_of_images
from panobench.plugins import registry
from panobench.specs import DatasetSpec

_SIMPLE = ("erp", "pal", "cubemap", "pinhole:DEGREES", "fisheye:DEGREES")


class SingleImage(FrameSequence):
    """One image at time 0; ``layout``: how a panorama lies in it, None for what ``camera`` took as it is."""

    def __init__(self, path: Path, camera: Camera, layout: Layout | None = None) -> None:
        self.path, self.camera, self._layout = path, camera, layout
        self.name, self.dataset = path.stem, "image"
        self.times = np.zeros(1)

    def image(self, index: int) -> NDArray[np.uint8]:
        image = read_image(self.path)
        if self._layout is None:
            return image
        return self._layout.unpack(image, (self.camera.width, self.camera.height))

    def frame_name(self, index: int) -> str:
        return self.path.name

    def remarks(self) -> list[str]:
        return [self._layout.remark] if self._layout is not None and self._layout.remark else []


def panorama_in(path: Path, option: str | None) -> SingleImage:
    """An image as a panorama: as it is, or in the layout that `--layout` says or that is recognised.

    Raises DatasetError for one that is no panorama.
    """
    lens = f"--camera what took it ({', '.join(_SIMPLE)}, or a calibration file)"
    return SingleImage(path, *panorama_of_images([path], read_size(path), option, lens))


def camera_of_image(option: str, size: tuple[int, int], path: Path) -> Camera:
    """The camera that took an image of ``size`` (w, h): a calibration file, or one of the simple models.

    Raises UsageError, UnknownNameError or CalibrationError.
    """
    from panobench.cameras.calibration import builtin_calibration, read_calibration, require_size

    width, height = size
    if calibration_file(option) is not None:
        camera = read_calibration(option)
        require_size(camera, width, height, option)
        return camera
    model, _, argument = option.partition(":")
    if model == "erp":
        from panobench.cameras.erp import ErpCamera

        return ErpCamera(width, height)
    if model == "pal":
        camera = builtin_calibration("palvio_up")
        require_size(camera if width == camera.width else camera.scaled(width), width, height, path)
        return camera if width == camera.width else camera.scaled(width)
    if model == "cubemap":
        from panobench.cameras.cubemap import CubemapCamera

        return CubemapCamera(width, height)
    if model in ("pinhole", "fisheye"):
        return _from_angle(model, argument, size)
    raise UnknownNameError("camera", model, [name.partition(":")[0] for name in _SIMPLE])


def _from_angle(model: str, argument: str, size: tuple[int, int]) -> Camera:
    """An ideal camera from its horizontal field of view in degrees."""
    from panobench.cameras.kannala_brandt import KannalaBrandtCamera
    from panobench.cameras.pinhole import PinholeCamera

    width, height = size
    limit = 180 if model == "pinhole" else 360
    try:
        angle = float(argument)
    except ValueError:
        angle = 0.0
    if not 0 < angle < limit:
        raise UsageError(
            f"--camera {model}: add its horizontal field of view below {limit} degrees, as in {model}:90, "
            "or name a calibration file"
        )
    if model == "pinhole":
        f = width / 2 / np.tan(np.deg2rad(angle) / 2)
        values = {"model": "pinhole", "width": width, "height": height}
        return PinholeCamera.from_dict({**values, "fx": f, "fy": f, "cx": width / 2, "cy": height / 2})
    if width != height:
        raise UsageError(f"--camera fisheye needs a square image with the circle in it, not {width}x{height}")
    return KannalaBrandtCamera.equidistant(width, angle)


def open_anything(
    path: Path,
    camera: str | None = None,
    dataset: str | None = None,
    sequence: str | None = None,
    given: Given | None = None,
) -> FrameSequence:
    """An image seen by ``camera``, or a sequence, whose dataset is guessed unless it is named.

    camera: a calibration file for images and bags whose own does not say what took them.
    """
    given = given or Given()
    if not path.exists():
        raise DatasetError("no such file or folder", path)
    if dataset is None and path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES:
        if camera is None:
            return panorama_in(path, given.layout)
        if given.layout is not None:
            raise UsageError("--layout and --camera exclude each other: both say what took the image")
        return SingleImage(path, camera_of_image(camera, read_size(path), path))
    name, root = dataset, path
    if name is None:
        found = guess(path)
        name, root = found.dataset, found.root
    if camera is not None:
        if "calibration" not in registry().get(DatasetSpec, name).load().takes:
            raise UsageError(f"--camera is for images, videos and bags; a sequence of '{name}' has its own camera")
        if calibration_file(camera) is None:
            raise UsageError(f"--camera {camera}: models are for single images, a sequence takes a calibration file")
        given = replace(given, calibration=camera)
    return open_sequence(name, sequence, root, given=given)

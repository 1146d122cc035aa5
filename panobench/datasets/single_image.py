"""An image file, or any dataset at a path, as a sequence, for `panobench view`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.datasets.images import IMAGE_SUFFIXES, read_image, read_size
from panobench.datasets.listing import children
from panobench.datasets.open import open_sequence
from panobench.datasets.video import VIDEO_SUFFIXES
from panobench.errors import DatasetError, UnknownNameError, UsageError

_SIMPLE = ("erp", "pal", "cubemap", "pinhole:DEGREES", "fisheye:DEGREES")


class SingleImage(FrameSequence):
    """One image at time 0."""

    def __init__(self, path: Path, camera: Camera) -> None:
        self.path, self.camera = path, camera
        self.name, self.dataset = path.stem, "image"
        self.times = np.zeros(1)

    def image(self, index: int) -> NDArray[np.uint8]:
        return read_image(self.path)

    def frame_name(self, index: int) -> str:
        return self.path.name


def camera_of_image(option: str | None, size: tuple[int, int], path: Path) -> Camera:
    """The camera that took an image of ``size`` (w, h): a calibration file, or one of the simple models.

    None: erp for an image twice as wide as high. Raises UsageError, UnknownNameError or CalibrationError.
    """
    from panobench.cameras.calibration import builtin_calibration, calibration_file, read_calibration, require_size

    width, height = size
    if option is None:
        if width != 2 * height:
            raise UsageError(
                f"{path} is {width}x{height}, no panorama: say with --camera what took it "
                f"({', '.join(_SIMPLE)}, or a calibration file)"
            )
        option = "erp"
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


#: What only one layout has, in a sequence's folder or one above it.
_MARKS = {
    "mav0": "tum-vi",
    "*/mav0": "tum-vi",
    "camera_pose.json": "360loc",
    "*/*/*/camera_pose.json": "360loc",
    "transform.json": "omniblender",
    "*/transform.json": "omniblender",
    "Egocentric/cameras": "omniblender",
    "*/Egocentric/cameras": "omniblender",
}


def _guess_video(path: Path) -> str:
    """Footage of two lenses has their calibration beside it."""
    both = path.with_name(f"{path.stem}.dual.yaml").is_file() or path.with_name("dual_fisheye.yaml").is_file()
    return "insta360-dual-fisheye" if both else "video"


def guess_dataset(path: Path) -> str:
    """The name of the dataset whose adapter reads ``path``. Raises DatasetError if there is none."""
    if path.is_file():
        if path.suffix.lower() in VIDEO_SUFFIXES:
            return _guess_video(path)
        if path.suffix == ".bag":
            return "palvio"
    elif path.is_dir():
        if (path / "frames.csv").is_file() or any(path.glob("*/frames.csv")):
            return "folder"
        if (path / "groundtruth.txt").is_file() or any(path.glob("*/groundtruth.txt")):
            return "synpano"
        if any(path.glob("*.bag")):
            return "palvio"
        for pattern, dataset in _MARKS.items():
            if any(path.glob(pattern)):
                return dataset
        videos = [p for p in children(path) if p.suffix.lower() in VIDEO_SUFFIXES]
        if videos:
            return _guess_video(videos[0])
    raise DatasetError("neither an image nor a sequence that is recognised; name its --dataset", path)


def open_anything(
    path: Path, camera: str | None = None, dataset: str | None = None, sequence: str | None = None
) -> FrameSequence:
    """An image seen by ``camera``, or a sequence, whose dataset is guessed unless it is named."""
    if not path.exists():
        raise DatasetError("no such file or folder", path)
    if dataset is None and path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES:
        return SingleImage(path, camera_of_image(camera, read_size(path), path))
    if camera is not None:
        raise UsageError("--camera is for single images; a sequence has its own camera")
    return open_sequence(dataset or guess_dataset(path), sequence, path)

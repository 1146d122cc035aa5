"""Finding out which calibration file it is, and reading or writing it."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from panobench.cameras.base import Camera
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import read_text
from panobench.errors import CalibrationError, UnknownNameError

#: format -> the module with recognise, read and write, in the order they are tried.
FORMATS = {
    "panobench": "panobench.cameras.calibration.panobench_yaml",
    "kalibr": "panobench.cameras.calibration.kalibr",
    "lfvio": "panobench.cameras.calibration.lfvio",
    "ocamcalib": "panobench.cameras.calibration.ocamcalib",
    "colmap": "panobench.cameras.calibration.colmap",
}
_YAML_FORMATS = {"panobench", "kalibr", "lfvio"}
#: What the formats are told apart by, for whoever has a file that is none of them.
_YAML_MARKS = (
    "YAML with 'model:' (panobench), 'camera_model:' and 'intrinsics:' (kalibr), "
    "or 'model_type:' and 'image_width:' (lfvio) is expected"
)
_TEXT_MARKS = "five lines of numbers (ocamcalib) or lines 'ID MODEL WIDTH HEIGHT PARAMS...' (colmap) are expected"
_DATA = Path(__file__).parent / "data"


def read_calibration(
    path: Path | str,
    format: str | None = None,
    *,
    camera: str | None = None,
    annulus: tuple[float, float] | None = None,
    size: tuple[int, int] | None = None,
) -> Camera:
    """The camera in a calibration file of any known format (recognised unless ``format`` says which).

    camera:  which one of a Kalibr chain (cam0, ...) or a COLMAP file (id); None: the first.
    annulus: r_min, r_max in pixels between which a polynomial camera is valid, where the file does not say.
    size:    width and height of the images it is for.
    Raises CalibrationError naming file and line, also for a calibration of another size.
    """
    return inspect_calibration(path, format, camera=camera, annulus=annulus, size=size).camera


def inspect_calibration(
    path: Path | str,
    format: str | None = None,
    *,
    camera: str | None = None,
    annulus: tuple[float, float] | None = None,
    size: tuple[int, int] | None = None,
) -> Calibration:
    """As ``read_calibration``, with the format, notes on what was found, extrinsics and time offset."""
    path = Path(path)
    module = _module(format) if format is not None else _recognise(path)
    calibration: Calibration = module.read(path, ReadOptions(camera, annulus))
    if size is not None:
        require_size(calibration.camera, *size, path=path)
    return calibration


def write_calibration(camera: Camera, path: Path | str, format: str = "panobench") -> None:
    """Write a calibration file. Raises UnsupportedError when the format does not have the camera's model."""
    _module(format).write(camera, Path(path))


def builtin_calibration(name: str) -> Camera:
    """The camera of a calibration that comes with the package: palvio_up or palvio_down. Raises UnknownNameError."""
    return inspect_builtin(name).camera


def inspect_builtin(name: str) -> Calibration:
    """As ``builtin_calibration``, with extrinsics and time offset."""
    known = sorted(p.stem for p in _DATA.glob("*.yaml"))
    if name not in known:
        raise UnknownNameError("built-in calibration", name, known)
    return inspect_calibration(_DATA / f"{name}.yaml", "panobench")


def require_size(camera: Camera, width: int, height: int, path: Path | str | None = None) -> None:
    """Raise CalibrationError unless the camera is for images of this size."""
    if (camera.width, camera.height) == (width, height):
        return
    message = f"the calibration is for {camera.width}x{camera.height} images, these are {width}x{height}"
    if camera.width * height == camera.height * width:
        message += "; if they were only resized, scale the calibration with Camera.scaled"
    raise CalibrationError(message, path)


def _module(format: str) -> Any:
    if format not in FORMATS:
        raise UnknownNameError("calibration format", format, FORMATS)
    return importlib.import_module(FORMATS[format])


def _recognise(path: Path) -> Any:
    text = read_text(path)
    yaml_like = path.suffix.lower() in {".yaml", ".yml"}
    for name in FORMATS:
        if yaml_like and name not in _YAML_FORMATS:
            continue
        module = _module(name)
        if module.recognise(path, text):
            return module
    raise CalibrationError(f"not recognised as a calibration: {_YAML_MARKS if yaml_like else _TEXT_MARKS}", path)

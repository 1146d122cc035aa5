"""Finding out which calibration file it is, and reading or writing it."""

from __future__ import annotations

import importlib
import warnings
from pathlib import Path
from typing import Any

from panobench.cameras.base import Camera
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import MAX_BYTES, read_bytes, read_text
from panobench.errors import CalibrationError, InputWarning, UnknownNameError, UnsupportedError

#: format -> the module with recognise, read and (where it is written, too) write, in the order they are tried.
FORMATS = {
    "panobench": "panobench.cameras.calibration.panobench_yaml",
    "kalibr": "panobench.cameras.calibration.kalibr",
    "lfvio": "panobench.cameras.calibration.lfvio",
    "slam-settings": "panobench.cameras.calibration.slam_settings",
    "basalt": "panobench.cameras.calibration.basalt",
    "nerfstudio": "panobench.cameras.calibration.nerfstudio",
    "opencv": "panobench.cameras.calibration.opencv",
    "ocamcalib": "panobench.cameras.calibration.ocamcalib",
    "colmap": "panobench.cameras.calibration.colmap",
}
#: Formats that are lines of numbers and words rather than tables with keys.
_LINES = {"ocamcalib", "colmap"}
#: Formats that are written as well.
WRITTEN = ("panobench", "kalibr", "lfvio", "ocamcalib", "colmap")
#: How a file's name ends that is taken for a calibration even where there is no such file.
SUFFIXES = (".yaml", ".yml", ".txt", ".xml", ".json", ".bin")
#: What the formats are told apart by, for whoever has a file that is none of them.
_TABLE_MARKS = (
    "'model:' (panobench), 'camera_model:' and 'intrinsics:' (kalibr), 'model_type:' and 'image_width:' (lfvio), "
    "'camera_matrix' or 'K' (OpenCV, ROS camera_info), 'Camera1.fx' (ORB-SLAM) or 'Camera:' (stella_vslam), "
    "'camera_type' (Basalt) or 'frames' (nerfstudio) is expected"
)
_TEXT_MARKS = "five lines of numbers (ocamcalib) or lines 'ID MODEL WIDTH HEIGHT PARAMS...' (colmap) are expected"
_DATA = Path(__file__).parent / "data"


def split_choice(path: Path | str) -> tuple[Path, str | None]:
    """ "calib.yaml#cam1" -> the file and the camera in it; None where nothing is chosen or a file is called so."""
    text = str(path)
    if "#" not in text or is_file(Path(text)):
        return Path(text), None
    file, _, name = text.rpartition("#")
    return Path(file), name or None


def calibration_file(option: str) -> str | None:
    """``option`` if it means a calibration file and not a camera model: a file that is there, or one called so.

    A model's bare name stays a model; ./erp is a file of that name.
    """
    from panobench.plugins import registry
    from panobench.specs import CameraSpec

    if option.partition(":")[0] in registry().specs(CameraSpec) and not Path(option).suffix:
        return None
    path, _ = split_choice(option)
    named_so = path.suffix.lower() in SUFFIXES or "/" in option
    return option if named_so or is_file(path) or path.is_dir() else None


def is_file(path: Path) -> bool:
    """Whether there is such a file; names that no file can have are none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, a NUL
        return False


def read_calibration(
    path: Path | str,
    format: str | None = None,
    *,
    camera: str | None = None,
    annulus: tuple[float, float] | None = None,
    size: tuple[int, int] | None = None,
) -> Camera:
    """The camera in a calibration file of any known format (recognised unless ``format`` says which).

    camera:  which one of a file with several (cam1 of a Kalibr chain, an id of COLMAP's), as after the # in
             "camchain.yaml#cam1"; None: the first.
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
    path, chosen = split_choice(path)
    if chosen is not None and camera is None:
        camera = chosen
    if path.is_dir():
        raise CalibrationError("this is a folder; name the calibration file in it", path)
    module = _module(format) if format is not None else _recognise(path)
    calibration: Calibration = module.read(path, ReadOptions(camera, annulus))
    for doubt in calibration.doubts:
        warnings.warn(f"{path}: {doubt}", InputWarning, stacklevel=2)
    if size is not None:
        require_size(calibration.camera, *size, path=path)
    return calibration


def write_calibration(camera: Camera, path: Path | str, format: str = "panobench") -> None:
    """Write a calibration file. Raises UnsupportedError when the format does not have the camera's model."""
    module = _module(format)
    if not hasattr(module, "write"):
        raise UnsupportedError(
            f"calibrations of format '{format}' are read, not written; {camera.kind} cameras go to {', '.join(WRITTEN)}"
        )
    module.write(camera, Path(path))


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


def is_calibration(path: Path) -> bool:
    """Whether a file looks like a calibration of a known format; it may have mistakes all the same."""
    try:
        _recognise(path)
    except CalibrationError:
        return False
    return True


def _module(format: str) -> Any:
    if format not in FORMATS:
        raise UnknownNameError("calibration format", format, FORMATS)
    return importlib.import_module(FORMATS[format])


def _recognise(path: Path) -> Any:
    from panobench.cameras.calibration import colmap, nerfstudio

    large = path.suffix.lower() in (".json", ".bin", ".txt")  # with the frames of a whole reconstruction
    data = read_bytes(path, nerfstudio.MAX_BYTES if large else MAX_BYTES)
    if b"\0" in data and colmap.recognise_binary(path, data):
        return colmap
    text = read_text(path, nerfstudio.MAX_BYTES)
    table_like = path.suffix.lower() in {".yaml", ".yml", ".json", ".xml"} or text.lstrip()[:1] in ("<", "%")
    for name in FORMATS:
        if table_like and name in _LINES:
            continue
        module = _module(name)
        if module.recognise(path, text):
            return module
    raise CalibrationError(f"not recognised as a calibration: {_TABLE_MARKS if table_like else _TEXT_MARKS}", path)

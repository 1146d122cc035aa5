"""COLMAP's cameras.txt: `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`, pixel centres at 0.5 as here.

https://colmap.github.io/cameras.html; EQUIRECTANGULAR and EUCM since COLMAP 4.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from panobench.cameras.base import Camera
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import as_number, data_lines, read_text, write_text
from panobench.cameras.erp import ErpCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError, UnknownNameError, UnsupportedError

NAME = "colmap"
Maker = Callable[..., Camera]


def _fisheye(w: int, h: int, fx: float, fy: float, cx: float, cy: float, *k: float) -> Camera:
    return KannalaBrandtCamera(w, h, fx, fy, cx, cy, (*k, *([0.0] * (4 - len(k)))))


def _full(w: int, h: int, fx: float, fy: float, cx: float, cy: float, *k: float) -> Camera:
    return PinholeCamera(w, h, fx, fy, cx, cy, k)


#: model -> number of parameters and how to make the camera.
_MODELS: dict[str, tuple[int, Maker]] = {
    "SIMPLE_PINHOLE": (3, lambda w, h, f, cx, cy: PinholeCamera(w, h, f, f, cx, cy)),
    "PINHOLE": (4, _full),
    "SIMPLE_RADIAL": (4, lambda w, h, f, cx, cy, k: _full(w, h, f, f, cx, cy, k, 0.0, 0.0, 0.0)),
    "RADIAL": (5, lambda w, h, f, cx, cy, k1, k2: _full(w, h, f, f, cx, cy, k1, k2, 0.0, 0.0)),
    "OPENCV": (8, _full),
    "FULL_OPENCV": (12, _full),
    "OPENCV_FISHEYE": (8, _fisheye),
    "SIMPLE_RADIAL_FISHEYE": (4, lambda w, h, f, cx, cy, k: _fisheye(w, h, f, f, cx, cy, k)),
    "RADIAL_FISHEYE": (5, lambda w, h, f, cx, cy, k1, k2: _fisheye(w, h, f, f, cx, cy, k1, k2)),
    "SIMPLE_FISHEYE": (3, lambda w, h, f, cx, cy: _fisheye(w, h, f, f, cx, cy)),
    "FISHEYE": (4, _fisheye),
    "EUCM": (6, lambda w, h, fx, fy, cx, cy, a, b: EucmCamera(w, h, fx, fy, cx, cy, a, b)),
    "EQUIRECTANGULAR": (2, lambda w, h, pw, ph: ErpCamera(w, h)),
}


def recognise(path: Path, text: str) -> bool:
    first = next(iter(data_lines(text)), (0, [""]))[1]
    return len(first) >= 4 and first[0].isdigit() and first[1].isupper()


def read(path: Path, options: ReadOptions) -> Calibration:
    """The camera of the id in the options, else the first. Raises CalibrationError naming the line."""
    rows = {words[0]: (line, words) for line, words in data_lines(read_text(path))}
    if not rows:
        raise CalibrationError("no camera line: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", path)
    if options.camera is not None and options.camera not in rows:
        raise CalibrationError(str(UnknownNameError("camera", options.camera, rows)), path)
    name = options.camera or next(iter(rows))
    line, words = rows[name]
    if len(words) < 4:
        raise CalibrationError("expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", path, line=line)
    if words[1] not in _MODELS:
        message = str(UnknownNameError("COLMAP model", words[1], _MODELS))
        raise CalibrationError(message, path, line=line)
    count, make = _MODELS[words[1]]
    numbers = [as_number(w, lambda m: CalibrationError(f"a parameter {m}", path, line=line)) for w in words[2:]]
    if len(numbers) != 2 + count:
        raise CalibrationError(
            f"{words[1]} has {count} parameters after width and height, found {len(numbers) - 2}", path, line=line
        )
    try:
        camera = make(*numbers)
    except CalibrationError as error:
        raise CalibrationError(str(error), path, line=line) from None
    others = [n for n in rows if n != name]
    return Calibration(
        camera, NAME, [f"camera {name}" + (f"; the file also has {', '.join(others)}" if others else "")]
    )


def write(camera: Camera, path: Path) -> None:
    """One camera with id 1. Raises UnsupportedError for models COLMAP does not have."""
    params: tuple[float, ...]
    if isinstance(camera, ErpCamera):
        if camera.solid_angle().min() == 0 and camera.mask is None:
            raise UnsupportedError("COLMAP's EQUIRECTANGULAR has no limited field of view; use a mask beside it")
        model, params = "EQUIRECTANGULAR", (float(camera.width), float(camera.height))
    elif isinstance(camera, EucmCamera):
        model, params = "EUCM", (camera.fx, camera.fy, camera.cx, camera.cy, camera.alpha, camera.beta)
    elif isinstance(camera, KannalaBrandtCamera):
        model, params = "OPENCV_FISHEYE", (camera.fx, camera.fy, camera.cx, camera.cy, *camera.k)
    elif isinstance(camera, PinholeCamera):
        k = camera.distortion
        model = {0: "PINHOLE", 4: "OPENCV"}.get(len(k), "FULL_OPENCV")
        k = (*k, *([0.0] * (8 - len(k)))) if model == "FULL_OPENCV" else k
        params = (camera.fx, camera.fy, camera.cx, camera.cy, *k)
    else:
        raise UnsupportedError(f"COLMAP has no model for {camera.kind}; it has erp, pinhole, fisheye and eucm")
    numbers = " ".join(repr(float(p)) for p in params)
    head = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    write_text(path, f"{head}1 {model} {camera.width} {camera.height} {numbers}\n")

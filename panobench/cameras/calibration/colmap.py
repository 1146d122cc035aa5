"""COLMAP's cameras.txt (`CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`) and cameras.bin; pixel centres at 0.5 as here.

cameras.bin, little-endian: the number of cameras (uint64), then of each its id (uint32), model (int32), width and
height (uint64) and parameters (float64). https://colmap.github.io/cameras.html and format.html; EQUIRECTANGULAR and
EUCM since COLMAP 4.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from panobench.cameras.base import Camera
from panobench.cameras.calibration.choice import choose, doubts, others
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import as_number, data_lines, read_bytes, read_text, write_text
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


def _panorama(w: int, h: int, pw: float, ph: float) -> Camera:
    if (pw, ph) != (w, h):
        raise CalibrationError(f"EQUIRECTANGULAR of {pw:g}x{ph:g} in an image of {w}x{h} is not read")
    return ErpCamera(w, h)


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
    "EQUIRECTANGULAR": (2, lambda w, h, pw, ph: _panorama(w, h, pw, ph)),
}


#: The numbers of models in cameras.bin: (name, number of parameters).
_NUMBERED = {
    **{0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8)},
    **{5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4)},
    **{9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16)},
    **{12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5), 14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4)},
    **{16: ("EUCM", 6), 17: ("EQUIRECTANGULAR", 2)},
}
#: Every image may have a camera of its own.
MAX_BYTES = 64 << 20


class Entry(NamedTuple):
    """One camera of the file: where it stands (a line, None in a binary file), model, width, height, parameters."""

    line: int | None
    model: str
    numbers: tuple[float, ...]

    def camera(self, path: Path) -> Camera:
        """Raises CalibrationError for a model that is not read, or numbers that make no camera."""
        if self.model not in _MODELS:
            message = str(UnknownNameError("COLMAP model", self.model, _MODELS))
            raise CalibrationError(message, path, line=self.line)
        count, make = _MODELS[self.model]
        if len(self.numbers) != 2 + count:
            raise CalibrationError(
                f"{self.model} has {count} parameters after width and height, found {len(self.numbers) - 2}",
                path,
                line=self.line,
            )
        try:
            return make(*self.numbers)
        except CalibrationError as error:
            raise CalibrationError(str(error), path, line=self.line) from None


def recognise(path: Path, text: str) -> bool:
    first = next(iter(data_lines(text)), (0, [""]))[1]
    return len(first) >= 4 and first[0].isdigit() and first[1].isupper()


def recognise_binary(path: Path, data: bytes) -> bool:
    """A count and a first camera of a known model, in a file whose length fits."""
    if len(data) < 32 or path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        return False
    count, _, model = struct.unpack_from("<QIi", data)
    return model in _NUMBERED and 0 < count <= len(data) // 24


def read(path: Path, options: ReadOptions) -> Calibration:
    """The camera of the id in the options, else the first. Raises CalibrationError naming the line."""
    rows = read_cameras(path)
    name = choose(path, options.camera, list(rows))
    camera = rows[name].camera(path)
    doubt = doubts(path, options.camera, name, list(rows))
    if len({row[1:] for row in rows.values()}) == 1:
        doubt = []  # the same camera again for every image
    return Calibration(camera, NAME, others(name, list(rows)), doubts=doubt)


def read_cameras(path: Path) -> dict[str, Entry]:
    """All cameras of a cameras.txt or cameras.bin by their id. Raises CalibrationError."""
    data = read_bytes(path, MAX_BYTES)
    rows = _binary_rows(data, path) if b"\0" in data else _text_rows(path)
    if not rows:
        raise CalibrationError("no camera line: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", path)
    return rows


def _text_rows(path: Path) -> dict[str, Entry]:
    rows = {}
    for line, words in data_lines(read_text(path, MAX_BYTES)):
        if len(words) < 4:
            raise CalibrationError("expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", path, line=line)
        numbers = [_parameter(w, path, line) for w in words[2:]]
        rows[words[0]] = Entry(line, words[1], tuple(numbers))
    return rows


def _parameter(word: str, path: Path, line: int) -> float:
    return as_number(word, lambda message: CalibrationError(f"a parameter {message}", path, line=line))


def _binary_rows(data: bytes, path: Path) -> dict[str, Entry]:
    rows = {}
    try:
        (count,) = struct.unpack_from("<Q", data)
        at = 8
        for _ in range(count):
            number, model, width, height = struct.unpack_from("<IiQQ", data, at)
            if model not in _NUMBERED:
                raise CalibrationError(f"camera {number} has the unknown model {model}; is this a cameras.bin?", path)
            name, parameters = _NUMBERED[model]
            values = struct.unpack_from(f"<{parameters}d", data, at + 24)
            at += 24 + 8 * parameters
            rows[str(number)] = Entry(None, name, (width, height, *values))
    except struct.error:
        raise CalibrationError("the file is cut short, or is no cameras.bin of COLMAP", path) from None
    return rows


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

"""OpenCV's FileStorage (YAML, XML, JSON), ROS's camera_info and EuRoC's sensor.yaml: a matrix and coefficients.

Pixels count from 0 at the first pixel's centre. Lenses: radial-tangential (4, 5 or 8 coefficients, more if the rest is
zero), cv::fisheye (ROS: equidistant) and cv::omnidir (with ``xi``).
https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, ROS REP 104 and sensor_msgs/CameraInfo.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.choice import choose, doubts, others
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.tables import as_table, matrix, read_table, rigid
from panobench.cameras.calibration.text import Table
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError

NAME = "opencv"
#: What the matrix is called, in lower case without punctuation; a number or a side by it tells cameras apart.
_MATRICES = ("cameramatrix", "intrinsicmatrix", "intrinsics", "cammatrix", "mtx", "k", "m")
_DISTORTIONS = (
    *("distortioncoefficients", "distortioncoeffs", "distortionparameters", "distcoefficients", "distcoeffs"),
    *("distcoeff", "distcoefs", "distortion", "dist", "d"),
)
_MODELS = ("distortionmodel", "cameramodel", "lensmodel", "model", "cameratype", "lenstype")
_WIDTHS, _HEIGHTS = ("imagewidth", "width", "cols", "w"), ("imageheight", "height", "rows", "h")
_SIZES = ("imagesize", "resolution", "size")
_RADTAN = ("plumbbob", "rationalpolynomial", "radtan", "radialtangential", "pinhole", "perspective", "opencv", "none")
_FISHEYE = ("equidistant", "fisheye", "kannalabrandt", "kannalabrandt4", "kb4", "equi", "opencvfisheye")
_OMNI = ("omnidir", "omnidirectional", "omni", "mei", "ucm")
_MATRIX_TEXT = re.compile(
    r"matrix|\bmtx\b|intrinsics\"?\s*:|^[\s{]*<?\"?[KM]\d?\"?\s*[:>]", re.IGNORECASE | re.MULTILINE
)


class _Keys(NamedTuple):
    """Where one camera's values are: its table, and what stands before or behind its keys."""

    table: Table
    side: str

    def find(self, names: tuple[str, ...], *, shared: bool = True) -> str | None:
        """The key that is one of ``names``, this camera's own first, then one for all cameras."""
        known = {_plain(key): key for key in self.table}
        for side in (self.side, "") if shared else (self.side,):
            for name in names:
                for spelt in (name + side, side + name):
                    if spelt in known:
                        return known[spelt]
        return None


def recognise(path: Path, text: str) -> bool:
    return bool(_MATRIX_TEXT.search(text)) or "<opencv_storage>" in text


def read(path: Path, options: ReadOptions) -> Calibration:
    """The camera named in the options, else the first. Raises CalibrationError naming the line where it can."""
    table = read_table(path)
    found = dict(_cameras(table))
    if not found:
        raise CalibrationError("no camera matrix: camera_matrix, cameraMatrix or K is expected, 3x3", path)
    name = choose(path, options.camera, list(found))
    try:
        camera, doubt = _camera(found[name])
    except CalibrationError as error:
        raise (error if error.path else CalibrationError(str(error), path)) from None
    notes = others(name, list(found)) if len(found) > 1 else []
    pose = _body_T_cam(found[name].table)
    return Calibration(camera, NAME, notes, pose, doubts=[*doubts(path, options.camera, name, list(found)), *doubt])


def read_camera_info(values: dict[str, Any], path: Path, *, rectified: bool = False) -> Calibration:
    """A sensor_msgs/CameraInfo with the names of its YAML file. rectified: of images without distortion (P, not K).

    Raises CalibrationError that names ``path``.
    """
    values = dict(values)
    P = values.pop("projection_matrix", [])
    if rectified and len(P) == 12 and P[0]:
        values |= {"camera_matrix": [*P[0:3], *P[4:7], *P[8:11]], "distortion_coefficients": []}
        values["distortion_model"] = "plumb_bob"
    camera, doubt = _camera(_Keys(as_table(values, path), ""))
    return Calibration(camera, NAME, doubts=doubt)


def _plain(key: str) -> str:
    return re.sub(r"[^a-z0-9]", "", key[:100].lower())


def _cameras(table: Table) -> Iterator[tuple[str, _Keys]]:
    """Name and place of every camera: by the matrices at the top, else by the tables that have one."""
    sides = []
    for key in table:
        for name in _MATRICES:
            match = re.fullmatch(rf"(left|right|cam\d|)_?{name}_?(left|right|l|r|\d|)", _plain(key))
            if match and not (match[1] and match[2]):
                sides.append(match[1] or match[2])
    if sides:
        yield from ((side or "camera", _Keys(table, side)) for side in dict.fromkeys(sides))
        return
    for key, value in table.items():
        if isinstance(value, Table) and _Keys(value, "").find(_MATRICES):
            yield key, _Keys(value, "")


def _camera(keys: _Keys) -> tuple[Camera, list[str]]:
    """The camera, and what had to be assumed."""
    table = keys.table
    name = keys.find(_MATRICES, shared=False) or keys.find(_MATRICES)
    assert name is not None
    fx, fy, cx, cy = _focal(table, name)
    width, height = _size(keys)
    _refuse_part_images(table)
    lens, k, key = _lens(keys)
    focal = (width, height, fx, fy, cx + 0.5, cy + 0.5)
    xi = keys.find(("xi",))
    try:
        if lens in _OMNI or xi is not None:
            if xi is None:
                raise table.error("an omnidirectional camera needs 'xi'")
            return MeiCamera(*focal, xi=_single(table, xi), distortion=_radtan(k)), []
        if lens in _FISHEYE:
            if len(k) not in (0, 4):
                raise table.error(f"a fisheye lens has 4 coefficients, not {len(k)}", key)
            return KannalaBrandtCamera(*focal, k=k or (0.0, 0.0, 0.0, 0.0)), []
        camera = PinholeCamera(*focal, distortion=_radtan(k))
    except CalibrationError as error:
        raise (error if error.path else table.error(str(error), key or name)) from None
    if lens or len(k) != 4 or not any(k):
        return camera, []
    return camera, [
        "four coefficients and no word on the lens: taken as radial-tangential (k1 k2 p1 p2); for cv::fisheye's "
        "k1 k2 k3 k4 add 'distortion_model: equidistant' to the file"
    ]


def _focal(table: Table, name: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a 3x3 matrix, or of these four numbers."""
    numbers = matrix(table, name)
    if len(numbers) == 4:
        fx, fy, cx, cy = map(float, numbers)
        return fx, fy, cx, cy
    K = matrix(table, name, 3, 3)
    if K[1, 0] or K[2, 0] or K[2, 1] or K[2, 2] != 1:
        raise table.error(f"'{name}' is no camera matrix [fx s cx; 0 fy cy; 0 0 1]", name)
    # A skew moves a pixel by so many pixels at 45 degrees off the axis.
    if abs(K[0, 1]) > 0.01:
        raise table.error(f"a skew of {K[0, 1]:g} px is not read: calibrate with it fixed (CALIB_FIX_SKEW)", name)
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def _size(keys: _Keys) -> tuple[int, int]:
    table = keys.table
    whole = keys.find(_SIZES)
    if whole is not None:
        numbers = matrix(table, whole)
        if len(numbers) != 2:
            raise table.error(f"'{whole}' must be width and height", whole)
        width, height = (float(v) for v in numbers)
    else:
        across, down = keys.find(_WIDTHS), keys.find(_HEIGHTS)
        if across is None or down is None:
            raise table.error("the image size is missing: add image_width and image_height to the file")
        width, height = _single(table, across), _single(table, down)
    if width != int(width) or height != int(height):
        raise table.error(f"the image size must be whole numbers, not {width:g}x{height:g}", whole)
    return int(width), int(height)


def _single(table: Table, key: str) -> float:
    """A number, or the one number of a 1x1 matrix."""
    if isinstance(table[key], (Table, list)):
        return float(matrix(table, key, 1, 1)[0, 0])
    return table.number(key)


def _lens(keys: _Keys) -> tuple[str, tuple[float, ...], str | None]:
    """What the lens is called ("" if nothing says so), its coefficients, and their key."""
    table = keys.table
    key = keys.find(_DISTORTIONS, shared=False) or (keys.find(_DISTORTIONS) if not keys.side else None)
    k = () if key is None else tuple(float(v) for v in matrix(table, key))
    flag = keys.find(("fisheyemodel", "fisheye", "isfisheye"))
    if flag is not None and str(table[flag]).strip().lower() not in ("0", "false", "0.0", "no", ""):
        return "fisheye", k, key
    model = keys.find(_MODELS)
    if model is None:
        return ("pinhole" if flag is not None else ""), k, key
    name = _plain(str(table[model]))
    if name not in (*_RADTAN, *_FISHEYE, *_OMNI):
        raise table.error(
            f"{model} '{table[model]}' is not known here; known: plumb_bob, rational_polynomial, equidistant, fisheye, "
            "omnidir",
            model,
        )
    return name, k, key


def _radtan(k: tuple[float, ...]) -> tuple[float, ...]:
    """Coefficients in OpenCV's order, without the zeros of a thin prism and a tilted sensor."""
    if len(k) in (12, 14):
        if any(k[8:]):
            raise CalibrationError(
                "a thin prism or tilted sensor is not read: calibrate without CALIB_THIN_PRISM_MODEL"
            )
        k = k[:8]
    return k if any(k) else ()


def _body_T_cam(table: Table) -> Array | None:
    """EuRoC's T_BS: the pose of the sensor on the body."""
    return rigid(table, "T_BS") if "T_BS" in table else None


def _refuse_part_images(table: Table) -> None:
    """camera_info of images that are binned or cut describes the whole sensor."""
    for key in ("binning_x", "binning_y"):
        if key in table and table.number(key) > 1:
            raise table.error("binned images are not read: calibrate the images as they are", key)
    roi: Any = table.get("roi")
    if isinstance(roi, Table) and not _whole(roi, table):
        raise table.error("a region of interest is not read: calibrate the images as they are", "roi")


def _whole(roi: Table, table: Table) -> bool:
    """Whether a region of interest is the whole image: all zero, or its size."""
    if roi.number("x_offset", 0.0) or roi.number("y_offset", 0.0):
        return False
    size = roi.number("width", 0.0), roi.number("height", 0.0)
    keys = _Keys(table, "")
    return not any(size) or size == tuple(float(v) for v in _size(keys))

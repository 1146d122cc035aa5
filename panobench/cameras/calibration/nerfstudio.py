"""The camera in a transforms.json of nerfstudio or instant-ngp; pixel centres at 0.5, as here.

https://docs.nerf.studio/quickstart/data_conventions.html. Poses are read by the dataset and by trajectory readers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from panobench.cameras.alike import middle_camera, middle_remark, sample
from panobench.cameras.base import Camera
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.tables import as_table
from panobench.cameras.calibration.text import Table
from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError, UnknownNameError, UnsupportedError
from panobench.reading import parse_json, read_text

NAME = "nerfstudio"
#: A transforms.json has every frame's pose.
MAX_BYTES = 64 << 20
_PERSPECTIVE = ("PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL", "OPENCV")
_FISHEYE, _PANORAMA = ("OPENCV_FISHEYE",), ("EQUIRECTANGULAR",)
_INTRINSICS = ("camera_model", "w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")


def recognise(path: Path, text: str) -> bool:
    return '"frames"' in text or '"fl_x"' in text or '"camera_angle_x"' in text


def read(path: Path, options: ReadOptions) -> Calibration:
    """Raises CalibrationError, also where frames have cameras of their own that differ."""
    text = read_text(path, "the calibration file", MAX_BYTES, CalibrationError)
    values = parse_json(text, path, CalibrationError)
    if options.camera is not None:
        raise CalibrationError(f"the file has one camera, no '{options.camera}'", path)
    if not isinstance(values, dict):
        raise CalibrationError("a table of values is expected", path)
    camera, remarks = camera_of(values, path)
    return Calibration(camera, NAME, list(remarks))


def camera_of(
    values: dict[str, Any], path: Path, size: tuple[int, int] | None = None
) -> tuple[Camera, tuple[str, ...]]:
    """The camera of the file's content, and what to say of it; ``size`` (w, h) of the images where it has none.

    Raises CalibrationError, also where frames have cameras of their own that differ.
    """
    own = _own(values)
    cameras = [_one_camera(values, one, path, size) for one in own]
    if len(cameras) == 1:
        return cameras[0], ()
    found = middle_camera(cameras)
    if found is None:
        raise CalibrationError("the frames have different cameras; one camera for all is read", path)
    return found[0], (middle_remark(found[1]),)


def _one_camera(values: dict[str, Any], own: dict[str, Any], path: Path, size: tuple[int, int] | None) -> Camera:
    """From what stands at the top and with a frame, of which the top counts."""
    table = as_table({**own, **{k: v for k, v in values.items() if k != "frames"}}, path)
    if size is not None:
        table = as_table({"w": size[0], "h": size[1], **table}, path)
    try:
        return _camera(table)
    except CalibrationError as error:
        raise (error if error.path else CalibrationError(str(error), path)) from None


def _own(values: dict[str, Any]) -> list[dict[str, Any]]:
    """The different sets of intrinsics that stand with frames; one that is empty where none has any."""
    frames = values.get("frames")
    frames = [f for f in frames if isinstance(f, dict)] if isinstance(frames, list) else []
    own: dict[tuple[object, ...], dict[str, Any]] = {}
    for frame in frames:
        found = {k: frame[k] for k in _INTRINSICS if k in frame}
        own[tuple((k, v if isinstance(v, (int, float, str)) else id(v)) for k, v in found.items())] = found
    return sample(list(own.values())) or [{}]


def _camera(table: Table) -> Camera:
    model = str(table.get("camera_model", "OPENCV_FISHEYE" if table.get("is_fisheye") else "PERSPECTIVE")).upper()
    known = (*_PERSPECTIVE, *_FISHEYE, *_PANORAMA)
    if model not in known:
        raise table.error(str(UnknownNameError("camera_model", model, known)))
    width, height = _whole(table, "w"), _whole(table, "h")
    if model in _PANORAMA:
        return ErpCamera(width, height)
    if "fl_x" in table or "camera_angle_x" not in table:
        fx = table.number("fl_x")
    else:
        angle = table.number("camera_angle_x")
        if not 0 < angle < np.pi:
            raise table.error(f"'camera_angle_x' must lie between 0 and pi, not {angle:g}")
        fx = width / 2 / np.tan(angle / 2)
    fy = table.number("fl_y", fx)
    focal = (width, height, fx, fy, table.number("cx", width / 2), table.number("cy", height / 2))
    k1, k2, k3, k4, p1, p2 = (table.number(k, 0.0) for k in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model in _FISHEYE:
        return KannalaBrandtCamera(*focal, k=(k1, k2, k3, k4))
    if k4:
        raise table.error("a fourth radial coefficient 'k4' is not read for perspective cameras")
    lens = (k1, k2, p1, p2, k3)
    return PinholeCamera(*focal, distortion=lens if any(lens) else ())


def _whole(table: Table, key: str) -> int:
    value = table.number(key)
    if value != int(value):
        raise table.error(f"'{key}' must be a whole number, not {value:g}")
    return int(value)


def camera_values(camera: Camera) -> dict[str, Any]:
    """The camera as ``camera_of`` reads it. Raises UnsupportedError for models that nerfstudio does not have."""
    size = {"w": camera.width, "h": camera.height}
    if isinstance(camera, ErpCamera):
        if camera.solid_angle().min() == 0 and camera.mask is None:
            raise UnsupportedError("nerfstudio's EQUIRECTANGULAR has no limited field of view")
        half = {"fl_x": camera.width / 2, "fl_y": camera.height, "cx": camera.width / 2, "cy": camera.height / 2}
        return {"camera_model": "EQUIRECTANGULAR", **size, **half}
    if isinstance(camera, KannalaBrandtCamera):
        model, lens = "OPENCV_FISHEYE", dict(zip(("k1", "k2", "k3", "k4"), camera.k))
    elif isinstance(camera, PinholeCamera) and not any(camera.distortion[5:]):
        model, lens = "OPENCV", dict(zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion))
    else:
        raise UnsupportedError(f"nerfstudio has no model for this {camera.kind}; it has erp, pinhole and fisheye")
    focal = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    return {"camera_model": model, **size, **focal, **lens}

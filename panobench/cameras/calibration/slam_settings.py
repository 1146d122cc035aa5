"""Settings files of feature SLAM systems: ORB-SLAM2 and 3 (``Camera1.fx``) and stella_vslam (``Camera: {fx: ...}``).

Pixels count from 0 at the first pixel's centre. ORB-SLAM3: "Calibration tutorial" in its repository; stella_vslam:
"Parameters" in its documentation.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.choice import choose, doubts, others
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.tables import read_table, rigid
from panobench.cameras.calibration.text import Table
from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError

NAME = "slam-settings"
_MARK = re.compile(r"^\s*\"?(Camera[12]?\.(fx|type|model|cols)\b|Camera\"?\s*:\s*(#.*)?$)", re.MULTILINE)
_PERSPECTIVE = ("pinhole", "perspective", "rectified")
_FISHEYE = ("kannalabrandt8", "kannalabrandt", "fisheye")


def recognise(path: Path, text: str) -> bool:
    return bool(_MARK.search(text))


def read(path: Path, options: ReadOptions) -> Calibration:
    """Camera1 or Camera2 of ORB-SLAM3 as the options say, else the first. Raises CalibrationError with the line."""
    table = _flat(read_table(path))
    names = [p for p in ("Camera1", "Camera2", "Camera") if f"{p}.fx" in table] or ["Camera"]
    name = choose(path, options.camera, names, "Camera")
    try:
        camera = _camera(table, name)
    except CalibrationError as error:
        raise (error if error.path else CalibrationError(str(error), path)) from None
    notes = others(name, names) if len(names) > 1 else []
    return Calibration(camera, NAME, notes, _body_T_cam(table, name), doubts=doubts(path, options.camera, name, names))


def _flat(table: Table) -> Table:
    """Nested sections as ORB-SLAM's dotted keys, with their lines."""
    flat = Table()
    flat.path, flat.line, flat.lines = table.path, table.line, {}
    for key, value, line in _entries(table, ""):
        if key in flat:
            raise CalibrationError(f"'{key}' is given twice", table.path, line=line)
        flat[key] = value
        if line is not None:
            flat.lines[key] = line
    return flat


def _entries(table: Table, prefix: str) -> Iterator[tuple[str, object, int | None]]:
    for key, value in table.items():
        line = table.lines.get(key)
        if isinstance(value, Table) and "data" not in value:
            yield from _entries(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value, line


def _camera(table: Table, name: str) -> Camera:
    kind = "Camera.model" if "Camera.model" in table else "Camera.type"
    model = str(table.get(kind, "PinHole")).strip().lower()
    width, height = _whole(table, "width", "cols"), _whole(table, "height", "rows")
    if model == "equirectangular":
        return ErpCamera(width, height)
    if model not in (*_PERSPECTIVE, *_FISHEYE):
        raise table.error(
            f"'{table[kind]}' is not known here; known: PinHole, Rectified, KannalaBrandt8 (ORB-SLAM3), perspective, "
            "fisheye, equirectangular (stella_vslam)",
            kind,
        )
    fx, fy, cx, cy = (table.number(f"{name}.{k}") for k in ("fx", "fy", "cx", "cy"))
    focal = (width, height, fx, fy, cx + 0.5, cy + 0.5)
    k1, k2, k3, k4, p1, p2 = (table.number(f"{name}.{k}", 0.0) for k in ("k1", "k2", "k3", "k4", "p1", "p2"))
    try:
        if model in _FISHEYE:
            return KannalaBrandtCamera(*focal, k=(k1, k2, k3, k4))
        lens = () if model == "rectified" else (k1, k2, p1, p2, k3)
        return PinholeCamera(*focal, distortion=lens if any(lens) else ())
    except CalibrationError as error:
        raise table.error(str(error), f"{name}.fx") from None


def _whole(table: Table, *names: str) -> int:
    """A size in pixels under any of its names."""
    key = next((f"Camera.{n}" for n in names if f"Camera.{n}" in table), None)
    if key is None:
        raise table.error(f"the image size is missing: add Camera.{names[0]} to the file")
    value = table.number(key)
    if value != int(value):
        raise table.error(f"'{key}' must be a whole number, not {value:g}", key)
    return int(value)


def _body_T_cam(table: Table, name: str) -> Array | None:
    """ORB-SLAM's pose of the first camera on the body, and the second's relative to it."""
    key = next((k for k in ("IMU.T_b_c1", "Tbc") if k in table), None)
    if key is None:
        return None
    T = rigid(table, key)
    if name != "Camera2":
        return T
    return T @ rigid(table, "Stereo.T_c1_c2") if "Stereo.T_c1_c2" in table else None

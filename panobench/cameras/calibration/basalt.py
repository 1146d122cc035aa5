"""Basalt's calibration.json: several cameras and where they sit on the IMU.

Pixels count from 0 at the first pixel's centre; T_imu_cam are poses of cameras on the body; ``cam_time_offset_ns`` is
added to camera times. https://gitlab.com/VladyslavUsenko/basalt-headers, files calibration.hpp and camera/*.hpp.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.choice import choose, doubts, others
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.tables import as_table, read_table
from panobench.cameras.calibration.text import Table
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError
from panobench.geometry import make_pose, matrix_from_quaternion

NAME = "basalt"


def recognise(path: Path, text: str) -> bool:
    return '"intrinsics"' in text and '"camera_type"' in text


def read(path: Path, options: ReadOptions) -> Calibration:
    """The camera of the options (cam0, cam1, ...), else the first. Raises CalibrationError."""
    whole = read_table(path)
    values = whole.table("value0") if "value0" in whole else whole
    intrinsics, sizes = values.need("intrinsics"), values.need("resolution")
    if not isinstance(intrinsics, list) or not isinstance(sizes, list) or not 0 < len(intrinsics) == len(sizes):
        raise CalibrationError("'intrinsics' and 'resolution' must be lists with one entry for each camera", path)
    names = [f"cam{i}" for i in range(len(intrinsics))]
    name = choose(path, options.camera, names, "cam")
    index = names.index(name)
    table = as_table(intrinsics[index], path)
    try:
        camera = _camera(table, sizes[index])
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}", None if error.path else path) from None
    offset = values.number("cam_time_offset_ns") * 1e-9 if "cam_time_offset_ns" in values else None
    pose = _pose(values, index)
    doubt = doubts(path, options.camera, name, names)
    return Calibration(camera, NAME, others(name, names), pose, offset, doubts=doubt)


def _camera(table: Table, size: Any) -> Camera:
    if not isinstance(size, list) or len(size) != 2 or not all(isinstance(v, int) for v in size):
        raise table.error("'resolution' must be width and height of each camera")
    kind, p = str(table.need("camera_type")), table.table("intrinsics")
    names = ("fx", "fy", "cx", "cy")
    if not all(n in p for n in names):
        raise table.error(f"'intrinsics' must have {', '.join(names)}")
    fx, fy, cx, cy = (p.number(n) for n in names)
    focal = (size[0], size[1], fx, fy, cx + 0.5, cy + 0.5)
    if kind == "ds":
        return DoubleSphereCamera(*focal, xi=p.number("xi"), alpha=p.number("alpha"))
    if kind == "eucm":
        return EucmCamera(*focal, alpha=p.number("alpha"), beta=p.number("beta"))
    if kind == "ucm":
        return EucmCamera(*focal, alpha=p.number("alpha"), beta=1.0)
    if kind == "kb4":
        return KannalaBrandtCamera(*focal, k=tuple(p.number(f"k{i}") for i in (1, 2, 3, 4)))
    if kind == "pinhole":
        return PinholeCamera(*focal)
    if kind == "pinhole-radtan8":
        k = tuple(p.number(n) for n in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"))
        return PinholeCamera(*focal, distortion=k if any(k) else ())
    raise table.error(f"camera_type '{kind}' is not known here; known: ds, eucm, ucm, kb4, pinhole, pinhole-radtan8")


def _pose(values: Table, index: int) -> Array | None:
    poses = values.get("T_imu_cam")
    if not isinstance(poses, list) or index >= len(poses) or not isinstance(poses[index], dict):
        return None
    table = as_table(poses[index], values.path or Path())
    q = np.array([table.number(k) for k in ("qw", "qx", "qy", "qz")])
    if abs(np.linalg.norm(q) - 1) > 0.05:
        raise table.error(f"the quaternion of 'T_imu_cam' has norm {np.linalg.norm(q):.4g}, not 1")
    return make_pose(matrix_from_quaternion(q), np.array([table.number(k) for k in ("px", "py", "pz")]))

"""Kalibr's camchain YAML: pinhole (radtan, equidistant), omni (radtan), eucm and ds.

Pixels count from 0 at the first pixel's centre. Sources: "Supported models" and "Yaml formats" in Kalibr's wiki,
https://github.com/ethz-asl/kalibr/wiki.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.choice import choose, doubts, others
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import Table, parse_yaml, read_text, write_text
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError, UnsupportedError
from panobench.geometry import invert_pose, renormalise
from panobench.reading import number_array

NAME = "kalibr"


def recognise(path: Path, text: str) -> bool:
    """EuRoC's sensor.yaml has these keys, too, at its top."""
    return "camera_model:" in text and "intrinsics:" in text and "sensor_type:" not in text


def read(path: Path, options: ReadOptions) -> Calibration:
    """The camera named in the options, else the first. Raises CalibrationError naming the line."""
    chain = parse_yaml(read_text(path), path)
    names = [k for k, v in chain.items() if isinstance(v, Table) and "camera_model" in v]
    if not names:
        raise chain.error("no camera (cam0, ...) with a camera_model")
    name = choose(path, options.camera, names, "cam")
    table = chain.table(name)
    try:
        camera = _camera(table)
    except CalibrationError as error:
        raise (error if error.path else table.error(str(error))) from None
    offset = table.number("timeshift_cam_imu") if "timeshift_cam_imu" in table else None
    doubt = doubts(path, options.camera, name, names)
    return Calibration(camera, NAME, others(name, names), _body_T_cam(table), offset, doubts=doubt)


def _camera(table: Table) -> Camera:
    model = str(table.need("camera_model"))
    lens = str(table.get("distortion_model", "none")).lower()
    width, height = (int(v) for v in table.numbers("resolution", 2))
    size = {"pinhole": 4, "omni": 5, "eucm": 6, "ds": 6}.get(model)
    if size is None:
        raise table.error(f"camera_model '{model}' is not known here; known: pinhole, omni, eucm, ds", "camera_model")
    *shape, fx, fy, cx, cy = table.numbers("intrinsics", size)
    if lens not in ("none", "radtan", "equidistant"):
        message = f"distortion_model '{lens}' is not known here; known: radtan, equidistant, none"
        raise table.error(message, "distortion_model")
    k = tuple(table.numbers("distortion_coeffs")) if "distortion_coeffs" in table else ()
    if len(k) not in (0, 4):
        raise table.error(f"'distortion_coeffs' must have 4 numbers, not {len(k)}", "distortion_coeffs")
    focal = (fx, fy, cx + 0.5, cy + 0.5)
    if not any(k) and model != "pinhole":
        lens = "none"
    if (model, lens) == ("pinhole", "equidistant"):
        return KannalaBrandtCamera(width, height, *focal, k or (0.0, 0.0, 0.0, 0.0))
    if model == "pinhole" and lens in ("none", "radtan"):
        return PinholeCamera(width, height, *focal, k if lens == "radtan" else ())
    if model == "omni" and lens in ("none", "radtan"):
        return MeiCamera(width, height, *focal, xi=shape[0], distortion=k if lens == "radtan" else ())
    if model == "eucm" and lens == "none":
        return EucmCamera(width, height, *focal, alpha=shape[0], beta=shape[1])
    if model == "ds" and lens == "none":
        return DoubleSphereCamera(width, height, *focal, xi=shape[0], alpha=shape[1])
    raise table.error(f"distortion_model '{lens}' with camera_model '{model}' is not known here", "distortion_model")


def _body_T_cam(table: Table) -> Array | None:
    if "T_cam_imu" not in table:
        return None
    T = number_array(table["T_cam_imu"])
    if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-2):
        raise table.error("'T_cam_imu' is not a rigid 4x4 matrix", "T_cam_imu")
    return renormalise(invert_pose(renormalise(T)))


def write(camera: Camera, path: Path) -> None:
    """A chain of one camera, cam0. Raises UnsupportedError for models Kalibr does not have."""
    lens = "none"
    shape: tuple[float, ...] = ()
    k: tuple[float, ...] = ()
    if isinstance(camera, PinholeCamera):
        model, lens, k = "pinhole", "radtan", camera.distortion
    elif isinstance(camera, KannalaBrandtCamera):
        model, lens, k = "pinhole", "equidistant", camera.k
    elif isinstance(camera, MeiCamera):
        model, shape, lens, k = "omni", (camera.xi,), "radtan", camera.distortion
    elif isinstance(camera, EucmCamera):
        model, shape = "eucm", (camera.alpha, camera.beta)
    elif isinstance(camera, DoubleSphereCamera):
        model, shape = "ds", (camera.xi, camera.alpha)
    else:
        raise UnsupportedError(f"Kalibr has no model for {camera.kind}; it has pinhole, fisheye, omni, eucm and ds")
    if lens == "radtan":
        if any(k[4:]):
            raise UnsupportedError("Kalibr's radtan holds four distortion coefficients (k1 k2 p1 p2) only")
        k = (*k[:4], 0.0, 0.0, 0.0, 0.0)[:4]
    intrinsics = [*shape, camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5]
    lines = [
        "cam0:",
        f"  camera_model: {model}",
        f"  intrinsics: {[float(v) for v in intrinsics]}",
        f"  distortion_model: {lens}",
        f"  distortion_coeffs: {[float(v) for v in k]}",
        f"  resolution: [{camera.width}, {camera.height}]",
    ]
    write_text(path, "\n".join(lines) + "\n")

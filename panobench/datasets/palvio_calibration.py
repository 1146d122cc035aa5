"""PALVIO's calibration: the annular camera, its mask, where it sits on the body, topics and time offset.

Facts collected from the public LF-VIO and LF-VISLAM repositories (Wang et al., "LF-VIO", IROS 2022; the
'up' camera, which the published evaluations use). A ``palvio.yaml`` beside the data replaces any of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Camera
from panobench.cameras.factory import camera_from_dict
from panobench.errors import CalibrationError
from panobench.geometry import make_pose, renormalise

Array = NDArray[np.float64]

WIDTH, HEIGHT = 1280, 960
#: Scaramuzza model of the 'up' camera; calibration tools count pixels from 0 at the first centre, hence + 0.5.
_UP_CAMERA: dict[str, Any] = {
    "model": "pal",
    "width": WIDTH,
    "height": HEIGHT,
    "poly": [-244.5239, 0.0, 1.748610e-3, -1.757770e-6, 4.475965e-9],
    "inv_poly": [376.845565, 246.746504, 19.035187, 23.840497, 18.991943, 6.066253, 1.560387, 5.854280]
    + [3.458320, -1.995166, -1.509264, 1.089614, 1.340245, 0.255323],
    "cx": 645.107791 + 0.5,
    "cy": 486.025172 + 0.5,
}
#: The valid annulus: centre (column, row; first pixel 0) and radii in pixels.
ANNULUS = ((640.991301, 490.937512), 160.0, 500.0)
_BODY_R_CAM = [
    [-1.7258e-4, -0.0512844, 0.9986841],
    [-0.9997760, 0.0211430, 9.1296e-4],
    [-0.0211620, -0.9984603, -0.0512766],
]
_BODY_T_CAM = [0.0920902, 3.6525e-5, -0.0503303]
OVERRIDE = "palvio.yaml"


@dataclass(frozen=True)
class PalvioCalibration:
    """What reading a PALVIO recording needs.

    body_T_cam: pose of the camera on the body (IMU axes), (4, 4). time_offset_s: IMU time minus camera time
    of the same instant ('td' of the VINS family).
    """

    camera: Camera
    body_T_cam: Array
    time_offset_s: float = -0.008
    image_topic: str = "/mindvision/mindvision/left/image_mono"
    imu_topic: str = "/mavros/imu/data"
    groundtruth_topic: str = "/vicon/pal/pal"
    source: str = "built in: 'up' camera of LF-VIO"


def annulus_mask(width: int, height: int, centre: ArrayLike, r_min: float, r_max: float) -> NDArray[np.bool_]:
    """(H, W): pixels whose distance from ``centre`` (column, row; first pixel 0) lies in [r_min, r_max]."""
    column0, row0 = np.asarray(centre, dtype=np.float64)
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    r = np.hypot(column - column0, row - row0)
    return np.asarray((r >= r_min) & (r <= r_max))


@lru_cache(maxsize=1)
def built_in_calibration() -> PalvioCalibration:
    """The 'up' camera's calibration, mask and extrinsics."""
    camera = camera_from_dict(_UP_CAMERA).with_mask(annulus_mask(WIDTH, HEIGHT, *ANNULUS))
    return PalvioCalibration(camera, renormalise(make_pose(_BODY_R_CAM, _BODY_T_CAM)))


def find_calibration(folder: Path) -> PalvioCalibration:
    """The built-in calibration with what ``folder/palvio.yaml``, if there is one, says differently.

    Keys, all optional: ``camera`` (as in a camera.yaml, or a calibration file's name), ``annulus``
    {centre, r_min, r_max}, ``body_T_cam`` (4x4), ``time_offset_s``, ``image_topic``, ``imu_topic``,
    ``groundtruth_topic``. Raises CalibrationError naming the file.
    """
    path = folder / OVERRIDE
    if not path.is_file():
        return built_in_calibration()
    import yaml

    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        raise CalibrationError("the file is not YAML", path, line=None if line is None else line + 1) from None
    if not isinstance(values, dict):
        raise CalibrationError("expected a table of values", path)
    try:
        return _replace(built_in_calibration(), values, path)
    except CalibrationError as error:
        raise CalibrationError(str(error), path) if error.path is None else error from None
    except (TypeError, ValueError, KeyError) as error:
        raise CalibrationError(f"the values cannot be used ({error})", path) from None


def _replace(base: PalvioCalibration, values: dict[str, Any], path: Path) -> PalvioCalibration:
    topics = ("image_topic", "imu_topic", "groundtruth_topic")
    unknown = sorted(set(values) - {"camera", "annulus", "body_T_cam", "time_offset_s", *topics})
    if unknown:
        raise CalibrationError(f"unknown key '{unknown[0]}'", path)
    changes: dict[str, Any] = {"source": str(path)} | {t: str(values[t]) for t in topics if t in values}
    camera = base.camera
    if "camera" in values:
        camera = _camera(values["camera"], path)
    if "annulus" in values:
        ring = values["annulus"]
        camera = camera.with_mask(
            annulus_mask(camera.width, camera.height, ring["centre"], float(ring["r_min"]), float(ring["r_max"]))
        )
    if "body_T_cam" in values:
        T = np.array(values["body_T_cam"], dtype=np.float64)
        if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-2):
            raise CalibrationError("'body_T_cam' is not a rigid 4x4 matrix", path)
        changes["body_T_cam"] = renormalise(T)
    if "time_offset_s" in values:
        changes["time_offset_s"] = float(values["time_offset_s"])
    return replace(base, camera=camera, **changes)


def _camera(value: Any, path: Path) -> Camera:
    if isinstance(value, str):
        from panobench.cameras.calibration import read_calibration

        return read_calibration(path.parent / value)
    return camera_from_dict(value)

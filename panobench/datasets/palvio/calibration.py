"""PALVIO's calibration: the annular camera with its mask, its pose on the body, topics and time offset.

The numbers are those of the built-in ``palvio_up``, the camera that the published evaluations use. The topics are from
the same public LF-VIO repository (Wang et al., "LF-VIO", IROS 2022). A ``palvio.yaml`` beside the data overrides them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import inspect_builtin, inspect_calibration
from panobench.errors import CalibrationError
from panobench.geometry import renormalise
from panobench.reading import inside, number_array, parse_yaml, read_text

Array = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
OVERRIDE = "palvio.yaml"
_TOPICS = ("image_topic", "imu_topic", "groundtruth_topic")


@dataclass(frozen=True)
class PalvioCalibration:
    """What reading a PALVIO recording needs.

    body_T_cam: pose of the camera on the body (IMU axes), (4, 4). time_offset_s: IMU time minus camera time
    of the same instant ('td' of the VINS family). gravity: m/s^2; PALVIO does not publish its own. mounting_given:
    body_T_cam is the user's; otherwise it is a published one, and the recording decides (``palvio_mounting``).
    """

    camera: Camera
    body_T_cam: Array
    time_offset_s: float
    gravity: float = STANDARD_GRAVITY
    mounting_given: bool = False
    image_topic: str = "/mindvision/mindvision/left/image_mono"
    imu_topic: str = "/mavros/imu/data"
    groundtruth_topic: str = "/vicon/pal/pal"
    source: str = "built in: palvio_up"


@lru_cache(maxsize=1)
def published_calibration() -> PalvioCalibration:
    """The 'up' camera's calibration, mask and extrinsics."""
    found = inspect_builtin("palvio_up")
    assert found.body_T_cam is not None
    assert found.time_offset_s is not None
    return PalvioCalibration(found.camera, found.body_T_cam, found.time_offset_s)


def find_calibration(folder: Path) -> PalvioCalibration:
    """The published calibration with the changes of ``folder/palvio.yaml``, if there is one.

    Keys, all optional: ``camera`` (a calibration file beside it, with its mask, extrinsics and time offset),
    ``body_T_cam`` (4x4), ``time_offset_s``, ``gravity`` (m/s^2), ``image_topic``, ``imu_topic``, ``groundtruth_topic``.
    Raises CalibrationError naming the file.
    """
    path = folder / OVERRIDE
    if not path.is_file():
        return published_calibration()
    text = read_text(path, "the calibration file", error=CalibrationError)
    values = parse_yaml(text, path, CalibrationError)
    if not isinstance(values, dict):
        raise CalibrationError("expected a table of values", path)
    unknown = sorted(set(map(str, values)) - {"camera", "body_T_cam", "time_offset_s", "gravity", *_TOPICS})
    if unknown:
        raise CalibrationError(f"unknown key '{unknown[0]}'", path)
    found = replace(published_calibration(), **_changes(values, path))
    if len({getattr(found, topic) for topic in _TOPICS}) < len(_TOPICS):
        raise CalibrationError(f"{', '.join(_TOPICS)} must be three different topics", path)
    return found


def _changes(values: dict[str, Any], path: Path) -> dict[str, Any]:
    """The file's values as fields of PalvioCalibration."""
    changes: dict[str, Any] = {"source": str(path)} | {t: str(values[t]) for t in _TOPICS if t in values}
    if "camera" in values:
        file = inside(path.parent, str(values["camera"]))
        if file is None:
            raise CalibrationError("'camera' must name a calibration file beside this one", path)
        found = inspect_calibration(file)
        changes["camera"] = found.camera
        if found.body_T_cam is not None:
            changes |= {"body_T_cam": found.body_T_cam, "mounting_given": True}
        if found.time_offset_s is not None:
            changes["time_offset_s"] = found.time_offset_s
    if "body_T_cam" in values:
        T = number_array(values["body_T_cam"])
        if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-2):
            raise CalibrationError("'body_T_cam' is not a rigid 4x4 matrix", path)
        changes |= {"body_T_cam": renormalise(T), "mounting_given": True}
    if "time_offset_s" in values:
        offset = values["time_offset_s"]
        if not isinstance(offset, (int, float)) or not abs(offset) < 1e9:
            raise CalibrationError(f"'time_offset_s' must be a number, not {offset!r}", path)
        changes["time_offset_s"] = float(offset)
    if "gravity" in values:
        gravity = values["gravity"]
        if not isinstance(gravity, (int, float)) or not 9.7 < gravity < 9.9:
            raise CalibrationError(f"'gravity' must be a number of m/s^2, not {gravity!r}", path)
        changes["gravity"] = float(gravity)
    return changes

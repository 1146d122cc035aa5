"""How PALVIO's camera sits on the body: its publications disagree, and a recording's gravity decides.

The same repository (LF-VIO) has given two poses of the 'up' camera in the IMU's axes. One has its optical axis along
the body's x: it stands beside a forward-looking stereo pair. The other is that of config/mindvision/mindvision.yaml
(LF-VIO and LF-VISLAM), which has this camera's very polynomial: a rotation of 180 degrees about the vertical and 3 cm
of height, and in a comment the calibrated matrix it was rounded from. By that one the lens looks up, as on the
published photograph. The accelerometer tells the two apart: on average, what it measures points up.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.views import upright_rotation
from panobench.datasets.palvio.calibration import PalvioCalibration
from panobench.geometry import make_pose
from panobench.types import Imu

Array = NDArray[np.float64]

#: Pose of the camera on the body in mindvision.yaml.
LOOKING_UP = make_pose(np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 0.0, 0.03]))
#: A recording whose up direction is further from the calibration's than this contradicts it, degrees.
DOUBTFUL_DEG = 45.0


def tilt_deg(calibration: PalvioCalibration, imu: Imu) -> float:
    """Angle between the camera's up direction by its mounting and the mean specific force, degrees."""
    up = calibration.body_T_cam[:3, :3] @ upright_rotation(calibration.camera).T @ np.array([0.0, -1.0, 0.0])
    force = imu.accel.mean(axis=0)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(up, force)), up @ force)))


def mounted_by_gravity(calibration: PalvioCalibration, imu: Imu | None) -> tuple[PalvioCalibration, list[str]]:
    """The calibration with the published pose that gravity agrees with, and remarks for the user.

    A pose that the user gave is kept; a remark says if gravity contradicts it.
    """
    if imu is None or not len(imu.times):
        return calibration, []
    choices = [calibration]
    if not calibration.mounting_given:
        choices.append(replace(calibration, body_T_cam=LOOKING_UP))
    tilts = [tilt_deg(choice, imu) for choice in choices]
    best = int(np.argmin(tilts))
    if tilts[best] > DOUBTFUL_DEG:
        return calibration, [
            f"by the IMU the camera's upward direction is {tilts[best]:.0f} degrees off the vertical: its pose on the "
            "body is doubtful, and so is the ground truth; give body_T_cam in palvio.yaml"
        ]
    if best == 0:
        return calibration, []
    return choices[best], [
        f"the camera's pose on the body is that of LF-VIO's configuration file: by the IMU the one of its README is "
        f"{tilts[0]:.0f} degrees off the vertical"
    ]

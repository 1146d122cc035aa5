"""The challenge's camera: two fisheye lenses back to back and an IMU; topics, noise and stamps of its recordings.

The numbers are those of the organisers' equidistant calibration (kalibr_imucam_chain.yaml, kalibr_imu_chain.yaml). The
sensors are mounted, and the pictures stored, upside down. The rig's axes are cam0's turned by half a turn about its
optical axis, so that y points down, and its origin lies midway between the lenses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.rig import Rig, RigLens
from panobench.capture.imu import ImuNoise
from panobench.errors import CalibrationError
from panobench.geometry import invert_pose, make_pose, renormalise

Array = NDArray[np.float64]

IMAGE_TOPICS = ("/cam0/image_raw/compressed", "/cam1/image_raw/compressed")
IMU_TOPIC = "/imu/data_raw"
IMAGE_RATE_HZ, IMU_RATE_HZ = 30.0, 1000.0
GRAVITY = 9.80766
NOISE = ImuNoise(gyro=0.00047032, accel=0.002859, gyro_walk=0.00036433, accel_walk=0.0013004)
#: Stamps of the images begin at this time, which the organisers added to all stamps, s.
STAMP_SHIFT_S = 10_000.0
#: The ground truth of so much of a recording's start is not judged, s.
UNJUDGED_S = 5.0
#: Rays of the lenses further from the axis than half of this hit the rim, degrees; the organisers mask it there, too.
FOV_DEG = 187.0
_UPRIGHT = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class HiltiCalibration:
    """cameras: of cam0 and cam1, at the size of the pictures. T_cam_imu: IMU axes to each camera's (4, 4), as Kalibr.

    time_offset_s: IMU time minus camera time of the same instant.
    """

    cameras: tuple[Camera, Camera]
    T_cam_imu: tuple[Array, Array]
    time_offset_s: float
    source: str = "built in: the organisers' equidistant calibration"

    @cached_property
    def T_cam0_rig(self) -> Array:
        """Pose (4, 4) of the rig's axes in cam0's."""
        other = (self.T_cam_imu[0] @ invert_pose(self.T_cam_imu[1]))[:3, 3]
        return np.asarray(make_pose(np.eye(3), 0.5 * other) @ _UPRIGHT)

    @cached_property
    def T_imu_rig(self) -> Array:
        """Pose (4, 4) of the rig's axes in the IMU's."""
        return np.asarray(invert_pose(self.T_cam_imu[0]) @ self.T_cam0_rig)

    def rig(self, readout_s: float | None = None) -> Rig:
        """Both lenses; the organisers do not publish the readout time."""
        to_rig = invert_pose(self.T_imu_rig)
        poses = (renormalise(to_rig @ invert_pose(T)) for T in self.T_cam_imu)
        return Rig(tuple(RigLens(c, T, readout_s) for c, T in zip(self.cameras, poses, strict=True)))

    def scaled(self, width: int) -> HiltiCalibration:
        """For pictures of another width."""
        front, back = self.cameras
        return replace(self, cameras=(front.scaled(width), back.scaled(width)))


def published_calibration() -> HiltiCalibration:
    """The organisers'."""
    front = _lens((461.640, 459.715, 732.946, 720.541), (0.0344292, -0.0215549, 0.0031293, -0.0005357))
    back = _lens((481.046, 478.001, 735.062, 720.095), (0.0469416, -0.0459889, 0.0119760, -0.0015767))
    T0 = [
        [0.0175386, 0.0002863, -0.9998461, 0.020524],
        [0.9998137, -0.0080641, 0.0175357, 0.014098],
        [-0.0080579, -0.9999674, -0.0004276, -0.011815],
        [0.0, 0.0, 0.0, 1.0],
    ]
    T1 = [
        [0.0007458, -0.0058479, 0.9999826, -0.019983],
        [0.9999502, -0.0099505, -0.0008040, 0.014616],
        [0.0099550, 0.9999334, 0.0058401, -0.028381],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return HiltiCalibration((front, back), (renormalise(np.array(T0)), renormalise(np.array(T1))), -0.006566)


def _lens(intrinsics: tuple[float, float, float, float], k: tuple[float, ...]) -> KannalaBrandtCamera:
    fx, fy, cx, cy = intrinsics  # Kalibr counts pixels from the first one's centre
    return KannalaBrandtCamera(1472, 1440, fx, fy, cx + 0.5, cy + 0.5, k, fov_deg=FOV_DEG)


def chain_calibration(path: Path) -> HiltiCalibration:
    """Of a Kalibr camchain with ``cam0``, ``cam1`` and their T_cam_imu. Raises CalibrationError."""
    from panobench.cameras.calibration import inspect_calibration

    found = [inspect_calibration(f"{path}#cam{k}") for k in (0, 1)]
    missing = next((k for k, each in enumerate(found) if each.body_T_cam is None), None)
    if missing is not None:
        raise CalibrationError(f"cam{missing} has no T_cam_imu: where the lenses are is not known without it", path)
    front, back = (_limited(each.camera) for each in found)
    poses = tuple(invert_pose(each.body_T_cam) for each in found if each.body_T_cam is not None)
    offsets = [each.time_offset_s for each in found if each.time_offset_s is not None]
    offset = float(np.mean(offsets)) if offsets else 0.0
    return HiltiCalibration((front, back), (poses[0], poses[1]), offset, str(path))


def _limited(camera: Camera) -> Camera:
    """Without what lies beyond the lens's rim."""
    if isinstance(camera, KannalaBrandtCamera):
        return replace(camera, fov_deg=min(camera.fov_deg, FOV_DEG))
    rays = camera.rays()
    with np.errstate(invalid="ignore"):
        inside = rays[..., 2] >= np.cos(np.deg2rad(FOV_DEG / 2))
    return camera if inside.all() else camera.with_mask(camera.valid_mask() & inside)


def operator_mask(camera: Camera) -> NDArray[np.bool_]:
    """(H, W) of a panorama in the rig's axes: False where the organisers' example hides who carries the camera.

    The upper tenth, the lower 16 hundredths, and a fifth at both sides below seven tenths (their stella_vslam
    configuration, equirectangular.yaml).
    """
    x = (np.arange(camera.width) + 0.5) / camera.width
    y = (np.arange(camera.height) + 0.5)[:, None] / camera.height
    return np.asarray((y > 0.1) & (y < 0.84) & ((y < 0.7) | ((x > 0.2) & (x < 0.8))))

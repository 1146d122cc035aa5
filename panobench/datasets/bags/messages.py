"""What messages of ROS's standard types say: stamps, poses, inertial samples, cameras and fixed transforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.bags.images import COMPRESSED, RAW
from panobench.geometry import invert_pose, make_pose, matrix_from_quaternion

Array = NDArray[np.float64]

IMAGES = (RAW, COMPRESSED)
IMU = ("sensor_msgs/msg/Imu",)
#: Poses that something else than the camera may have measured.
ODOMETRY = "nav_msgs/msg/Odometry"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    ODOMETRY,
)
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
#: ROS 1 has the same type in two packages.
TRANSFORM_KINDS = (TRANSFORMS, "tf/msg/tfMessage")


def stamp(message: Any) -> float:
    """Seconds; 0 where the sender did not set it."""
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


def imu_row(message: Any) -> tuple[float, ...]:
    """Time, angular rate in rad/s, specific force in m/s^2."""
    w, a = message.angular_velocity, message.linear_acceleration
    return (stamp(message), w.x, w.y, w.z, a.x, a.y, a.z)


def pose_row(message: Any) -> tuple[float, ...]:
    """Time, position, quaternion (w, x, y, z) of any of POSES."""
    if message.__msgtype__ == "geometry_msgs/msg/TransformStamped":
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose if message.__msgtype__ == "geometry_msgs/msg/PoseStamped" else message.pose.pose
        p, q = pose.position, pose.orientation
    return (stamp(message), p.x, p.y, p.z, q.w, q.x, q.y, q.z)


def body_frame(message: Any) -> str:
    """The coordinate frame whose pose it is; "" where the type does not say it."""
    return str(getattr(message, "child_frame_id", "")).lstrip("/")


def camera_values(message: Any) -> dict[str, Any] | None:
    """A CameraInfo as the table that `camera_calibration` writes to a file; None for a camera not calibrated."""

    def array(name: str) -> list[float]:
        return [float(v) for v in getattr(message, name, getattr(message, name.upper(), []))]

    K = array("k")
    if len(K) != 9 or not K[0]:
        return None
    roi = message.roi
    return {
        "image_width": int(message.width),
        "image_height": int(message.height),
        "camera_matrix": K,
        "distortion_model": str(message.distortion_model) or "plumb_bob",
        "distortion_coefficients": array("d"),
        "projection_matrix": array("p"),
        "binning_x": int(message.binning_x),
        "binning_y": int(message.binning_y),
        "roi": {k: int(getattr(roi, k)) for k in ("x_offset", "y_offset", "width", "height")},
    }


class FixedTransforms:
    """Frames that do not move against each other, from /tf_static."""

    def __init__(self) -> None:
        self._known: dict[str, dict[str, Array]] = {}

    def add(self, message: Any) -> None:
        """A TFMessage. Transforms that are no rigid motion are left out."""
        for each in message.transforms:
            t, q = each.transform.translation, each.transform.rotation
            numbers = np.array([t.x, t.y, t.z, q.w, q.x, q.y, q.z], dtype=np.float64)
            with np.errstate(over="ignore", invalid="ignore"):
                rigid = np.isfinite(numbers).all() and abs(np.linalg.norm(numbers[3:]) - 1) <= 0.05
            if not rigid:
                continue
            parent, child = str(each.header.frame_id).lstrip("/"), str(each.child_frame_id).lstrip("/")
            T = make_pose(matrix_from_quaternion(numbers[3:]), numbers[:3])
            self._known.setdefault(parent, {})[child] = T
            self._known.setdefault(child, {})[parent] = invert_pose(T)

    def between(self, body: str, camera: str) -> Array | None:
        """Pose (4, 4) of the frame ``camera`` in the frame ``body``; None if they are not connected."""
        found = {body: np.eye(4)} if body else {}
        waiting = list(found)
        while waiting:
            at = waiting.pop(0)
            if at == camera:
                return found[at]
            for other, T in self._known.get(at, {}).items():
                if other not in found:
                    found[other] = found[at] @ T
                    waiting.append(other)
        return None


def table_of(values: dict[str, Any], path: Path) -> Any:
    """``camera_values`` as a table that calibrations are read from."""
    from panobench.cameras.calibration.tables import as_table

    return as_table(values, path)

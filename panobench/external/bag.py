"""ROS 1 bags of grey images and inertial samples, for programs that subscribe to ROS topics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from panobench.datasets.base import FrameSequence
from panobench.types import Imu

IMAGE, IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"
#: Bags start at this time, because in ROS a time of zero means "not set". Answers are shifted back.
BAG_START_S = 1000


def write_bag(path: Path, sequence: FrameSequence, imu: Imu, image_topic: str, imu_topic: str) -> float:
    """Write a bag of mono8 images and inertial samples in the order of their times.

    Times are shifted so that the first one is BAG_START_S. Returns the seconds to add to the bag's times to get the
    sequence's.
    """
    import cv2
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    begin = min(float(sequence.times[0]), float(imu.times[0]) if len(imu.times) else np.inf)
    messages = _Messages(store.types, BAG_START_S - begin)
    with Writer(path) as writer:
        images = writer.add_connection(image_topic, IMAGE, typestore=store)
        samples = writer.add_connection(imu_topic, IMU, typestore=store)
        sent = 0

        def send_imu(until: float) -> None:
            nonlocal sent
            while sent < len(imu.times) and imu.times[sent] <= until:
                t = float(imu.times[sent])
                message = messages.imu(t, sent, imu.gyro[sent], imu.accel[sent])
                writer.write(samples, messages.nanoseconds(t), store.serialize_ros1(message, IMU))
                sent += 1

        for frame in sequence.frames():
            send_imu(frame.time)
            grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
            message = messages.image(frame.time, frame.index, np.asarray(grey, dtype=np.uint8))
            writer.write(images, messages.nanoseconds(frame.time), store.serialize_ros1(message, IMAGE))
        send_imu(np.inf)
    return begin - BAG_START_S


class _Messages:
    """Makes ROS messages; ``shift`` is added to all times."""

    def __init__(self, types: Any, shift: float) -> None:
        self._types, self._shift = types, shift

    def nanoseconds(self, time: float) -> int:
        return round((time + self._shift) * 1e9)

    def _header(self, time: float, seq: int, frame: str) -> Any:
        secs, nsecs = divmod(self.nanoseconds(time), 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=secs, nanosec=nsecs)
        return self._types["std_msgs/msg/Header"](seq=seq, stamp=stamp, frame_id=frame)

    def image(self, time: float, seq: int, grey: np.ndarray) -> Any:
        height, width = grey.shape
        return self._types[IMAGE](
            header=self._header(time, seq, "camera"),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(grey).reshape(-1),
        )

    def imu(self, time: float, seq: int, gyro: np.ndarray, accel: np.ndarray) -> Any:
        vector, none = self._types["geometry_msgs/msg/Vector3"], np.zeros(9)
        return self._types[IMU](
            header=self._header(time, seq, "body"),
            orientation=self._types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.array([-1.0, *np.zeros(8)]),  # REP 145: the orientation is not measured
            angular_velocity=vector(*(float(v) for v in gyro)),
            angular_velocity_covariance=none,
            linear_acceleration=vector(*(float(v) for v in accel)),
            linear_acceleration_covariance=none,
        )

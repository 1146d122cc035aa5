"""Messages of ROS's standard types made from arrays, for the bags that panobench writes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.bags.images import COMPRESSED, RAW
from panobench.datasets.bags.messages import IMU

Array = NDArray[np.float64]


class MessageMaker:
    """Makes messages of one distribution of ROS, whose ``types`` are those of a type store of `rosbags`."""

    def __init__(self, types: dict[str, Any]) -> None:
        self.types = types

    def header(self, nanoseconds: int, frame: str, seq: int | None = None) -> Any:
        """seq: the message's number, which headers of ROS 1 have and those of ROS 2 do not."""
        secs, nsecs = divmod(nanoseconds, 10**9)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=secs, nanosec=nsecs)
        number = {} if seq is None else {"seq": seq}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **number)

    def grey_image(self, header: Any, grey: NDArray[np.uint8]) -> Any:
        """A mono8 image."""
        height, width = grey.shape
        return self.types[RAW](
            header=header,
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(grey).reshape(-1),
        )

    def compressed_image(self, header: Any, data: bytes, kind: str) -> Any:
        """An image as a file of that kind ("jpeg", "png")."""
        return self.types[COMPRESSED](header=header, format=kind, data=np.frombuffer(data, np.uint8))

    def imu(self, header: Any, gyro: Array, accel: Array) -> Any:
        """An inertial sample: angular rate in rad/s, specific force in m/s^2, neither orientation nor covariances."""
        unknown = np.zeros(9)
        return self.types[IMU[0]](
            header=header,
            orientation=self.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.array([-1.0, *np.zeros(8)]),  # REP 145: -1 says that it is not measured
            angular_velocity=self.vector(gyro),
            angular_velocity_covariance=unknown,
            linear_acceleration=self.vector(accel),
            linear_acceleration_covariance=unknown,
        )

    def vector(self, v: Array) -> Any:
        x, y, z = (float(c) for c in v)
        return self.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)

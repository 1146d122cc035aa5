"""Small bags of every kind, written by `rosbags`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from dataset_samples import SIZE, panorama, poses
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from panobench.datasets.bags.dataset import Bag
from panobench.datasets.base import FrameSequence
from panobench.datasets.given import Given
from panobench.geometry import quaternion_from_matrix

START = 1_700_000_000
STEP_S = 0.1
FRAMES = 6
#: How a bag may be stored.
KINDS = ("ros1", "ros1-bz2", "ros1-lz4", "db3", "db3-file", "db3-message", "mcap", "mcap-storage")


class Messages:
    """Makes messages of ROS 1 or 2."""

    def __init__(self, ros1: bool) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types

    def make(self, kind: str, **fields: Any) -> Any:
        return self.types[kind](**fields)

    def data(self, message: Any) -> bytes:
        kind = message.__msgtype__
        return bytes(self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind))

    def header(self, time: float, frame: str = "cam") -> Any:
        seconds, nanoseconds = divmod(round(time * 1e9), 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **extra)

    def image(self, time: float, pixels: np.ndarray, encoding: str = "rgb8", **changes: Any) -> Any:
        """Rows without gaps, of any type and number of channels."""
        stored = np.ascontiguousarray(pixels)
        fields = {
            "header": self.header(time),
            "height": stored.shape[0],
            "width": stored.shape[1],
            "encoding": encoding,
            "is_bigendian": 0,
            "step": stored[0].nbytes,
            "data": stored.view(np.uint8).reshape(-1),
        }
        return self.make("sensor_msgs/msg/Image", **{**fields, **changes})

    def compressed(self, time: float, rgb: np.ndarray, form: str = "jpeg", suffix: str = ".jpg") -> Any:
        ok, data = cv2.imencode(suffix, rgb[..., ::-1] if rgb.ndim == 3 else rgb)
        assert ok
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time),
            format=form,
            data=np.frombuffer(data.tobytes(), np.uint8),
        )

    def _vector(self, kind: str, values: Any) -> Any:
        return self.make(kind, **dict(zip("xyz", map(float, values))))

    def quaternion(self, T: np.ndarray) -> Any:
        w, x, y, z = map(float, quaternion_from_matrix(T[:3, :3]))
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, kind: str, time: float, T: np.ndarray, child: str = "body") -> Any:
        """Any type of pose with a stamp."""
        header, q = self.header(time, "map"), self.quaternion(T)
        full = f"geometry_msgs/msg/{kind}"
        if kind == "TransformStamped":
            v = self._vector("geometry_msgs/msg/Vector3", T[:3, 3])
            transform = self.make("geometry_msgs/msg/Transform", translation=v, rotation=q)
            return self.make(full, header=header, child_frame_id=child, transform=transform)
        point = self._vector("geometry_msgs/msg/Point", T[:3, 3])
        pose = self.make("geometry_msgs/msg/Pose", position=point, orientation=q)
        if kind == "PoseStamped":
            return self.make(full, header=header, pose=pose)
        known = self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        if kind == "PoseWithCovarianceStamped":
            return self.make(full, header=header, pose=known)
        zero = self._vector("geometry_msgs/msg/Vector3", (0, 0, 0))
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        return self.make("nav_msgs/msg/Odometry", header=header, child_frame_id=child, pose=known, twist=twist)

    def static(self, parent: str, child: str, T: np.ndarray) -> Any:
        """One fixed transform of /tf_static."""
        transform = self.pose("TransformStamped", 0.0, T, child)
        transform.header.frame_id = parent
        return self.make("tf2_msgs/msg/TFMessage", transforms=[transform])

    def imu(self, time: float, gyro: Any, accel: Any) -> Any:
        return self.make(
            "sensor_msgs/msg/Imu",
            header=self.header(time, "imu"),
            orientation=self.quaternion(np.eye(4)),
            orientation_covariance=np.zeros(9),
            angular_velocity=self._vector("geometry_msgs/msg/Vector3", gyro),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector("geometry_msgs/msg/Vector3", accel),
            linear_acceleration_covariance=np.zeros(9),
        )

    def camera_info(self, size: tuple[int, int], K: list[float], D: list[float], model: str, **changes: Any) -> Any:
        roi = {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0, "do_rectify": False}
        P = [*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0]
        arrays = {"d": np.array(D), "k": np.array(K), "r": np.eye(3).reshape(-1), "p": np.array(P)}
        fields = {
            "header": self.header(0),
            "width": size[0],
            "height": size[1],
            "distortion_model": model,
            "binning_x": 0,
            "binning_y": 0,
            "roi": self.make("sensor_msgs/msg/RegionOfInterest", **roi),
            **{(k.upper() if self.ros1 else k): v for k, v in arrays.items()},
        }
        return self.make("sensor_msgs/msg/CameraInfo", **{**fields, **changes})


@dataclass
class Recording:
    """What to put into a bag: (topic, receive time in s, message), as ``Messages`` makes them."""

    messages: Messages
    rows: list[tuple[str, float, Any]] = field(default_factory=list)

    def add(self, topic: str, message: Any, received: float | None = None) -> None:
        stamp = message.header.stamp if hasattr(message, "header") else None
        time = START if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
        self.rows.append((topic, time if received is None else received, message))


def times(n: int = FRAMES) -> np.ndarray:
    return START + STEP_S * np.arange(n)


def images(recording: Recording, topic: str = "/cam/image_raw", n: int = FRAMES) -> None:
    for i, t in enumerate(times(n)):
        recording.add(topic, recording.messages.image(t, panorama(i)))


def truth(recording: Recording, topic: str = "/gt", kind: str = "PoseStamped", n: int = FRAMES) -> None:
    for t, T in zip(times(n), poses(n)):
        recording.add(topic, recording.messages.pose(kind, t, T))


def write(path: Path, fill: Callable[[Recording], None], kind: str = "ros1") -> Path:
    """Write a bag of one of KINDS. ROS 1: the file ``path``.bag; ROS 2: the folder ``path``."""
    storage, _, packing = kind.partition("-")
    recording = Recording(Messages(storage == "ros1"))
    fill(recording)
    target = path.with_name(f"{path.name}.bag") if storage == "ros1" else path
    path.parent.mkdir(parents=True, exist_ok=True)
    writer: Any
    if storage == "ros1":
        writer = Writer1(target)
        if packing:
            writer.set_compression(Writer1.CompressionFormat[packing.upper()])
    else:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(target, version=8, storage_plugin=plugin)
        if packing:
            writer.set_compression(CompressionMode[packing.upper()], CompressionFormat.ZSTD)
    with writer:
        known: dict[str, Any] = {}
        for topic, received, message in recording.rows:
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=recording.messages.store)
            writer.write(known[topic], round(received * 1e9), recording.messages.data(message))
    return target


def opened(path: Path, **given: Any) -> FrameSequence:
    dataset = Bag(path)
    dataset.given = Given(**given)
    return dataset.open()


def usual(recording: Recording) -> None:
    images(recording)
    truth(recording)
    for k in range(40):
        recording.add("/imu", recording.messages.imu(START + 0.0125 * k, (k, 0, 0), (0, 0, 9.8)))


__all__ = [
    "FRAMES",
    "KINDS",
    "SIZE",
    "START",
    "Messages",
    "Recording",
    "images",
    "opened",
    "times",
    "truth",
    "usual",
    "write",
]

"""ROS 1 bags of grey images and inertial samples, for programs that subscribe to ROS topics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from panobench.datasets.bags.images import RAW
from panobench.datasets.bags.making import MessageMaker
from panobench.datasets.bags.messages import IMU
from panobench.datasets.base import FrameSequence
from panobench.types import Imu

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
    make = MessageMaker(store.types)
    begin = min(float(sequence.times[0]), float(imu.times[0]) if len(imu.times) else np.inf)
    shift = BAG_START_S - begin

    def nanoseconds(time: float) -> int:
        return round((time + shift) * 1e9)

    with Writer(path) as writer:
        images = writer.add_connection(image_topic, RAW, typestore=store)
        samples = writer.add_connection(imu_topic, IMU[0], typestore=store)
        sent = 0

        def send_imu(until: float) -> None:
            nonlocal sent
            while sent < len(imu.times) and imu.times[sent] <= until:
                stamp = nanoseconds(float(imu.times[sent]))
                message = make.imu(make.header(stamp, "body", sent), imu.gyro[sent], imu.accel[sent])
                writer.write(samples, stamp, store.serialize_ros1(message, IMU[0]))
                sent += 1

        for frame in sequence.frames():
            send_imu(frame.time)
            stamp = nanoseconds(frame.time)
            grey = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
            message = make.grey_image(make.header(stamp, "camera", frame.index), grey)
            writer.write(images, stamp, store.serialize_ros1(message, RAW))
        send_imu(np.inf)
    return -shift

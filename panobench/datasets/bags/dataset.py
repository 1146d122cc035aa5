"""Any bag of ROS 1 or ROS 2 as a data set: images of one topic, with inertial samples and true poses if it has them.

The camera is that of ``--calibration``, else of a calibration file beside the bag, else of its CameraInfo, else a full
panorama. True poses are those of some body: they are moved to the camera by the calibration's extrinsics or by
/tf_static, and taken for the camera's own where neither says how it sits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import Calibration, inspect_calibration, split_choice
from panobench.cameras.calibration.opencv import read_camera_info
from panobench.datasets.bags.contents import Contents, Wanted, read_contents
from panobench.datasets.bags.files import BagFile
from panobench.datasets.bags.layout import find_bags
from panobench.datasets.bags.sequence import BagSequence, BagSource
from panobench.datasets.bags.topics import camera_topics, image_topic, imu_topic, truth_topic
from panobench.datasets.base import FrameSequence
from panobench.datasets.formats.image_folder import calibration_beside, for_size
from panobench.datasets.formats.synpano import panorama_camera
from panobench.datasets.found import FoundSequences
from panobench.errors import CalibrationError, DatasetError
from panobench.geometry import make_pose, matrix_from_quaternion
from panobench.masks.files import beside_video
from panobench.types import Imu, Trajectory

Array = NDArray[np.float64]


class Bag(FoundSequences):
    """Bags below ``root``, or ``root`` is one."""

    name = "bag"
    takes = frozenset({"calibration", "topic", "imu_topic", "groundtruth_topic"})

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset 'bag' needs --root PATH")
        found = find_bags(self.root)
        if not found:
            raise DatasetError("no bag here: .bag, .db3, .mcap, or a folder of ROS 2 with metadata.yaml", self.root)
        return found

    def contents(self, sequence: str | None = None) -> list[str]:
        """A line for each topic of a bag, for `panobench probe`."""
        bag = BagFile(self._choose(sequence)[1])
        return [f"{name} ({topic.kind}, {topic.count})" for name, topic in sorted(bag.topics.items())]

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        return BagSequence(self._read(BagFile(place), name), width)

    def _read(self, bag: BagFile, name: str) -> BagSource:
        image, images = image_topic(bag, self.given.topic)
        imu, imus = imu_topic(bag, self.given.imu_topic)
        truth, poses = truth_topic(bag, self.given.groundtruth_topic)
        contents = read_contents(bag, Wanted(image, imu, truth, camera_topics(bag, image)))
        lens = _lens(bag, image, contents, self.given.calibration)
        mask = beside_video(bag.path, contents.size)
        recorded, said = _truth(contents, lens, truth)
        topics = {"imu_topic": imu, "groundtruth_topic": truth}
        return BagSource(
            dataset=self.name,
            name=name,
            bag=bag,
            topic=image,
            contents=contents,
            native=mask.on(lens.camera),
            imu=_imu(contents, lens),
            recorded=recorded,
            inputs=tuple(mask.files()),
            notes={**topics, "calibration": lens.source, **_offset(lens), **mask.about()},
            remarks=(
                *lens.remarks,
                *_chosen("images", image, images, "--topic"),
                *_chosen("inertial samples", imu, imus, "--imu-topic"),
                *said,
                *_left(poses),
                *mask.remarks,
            ),
        )


def _chosen(what: str, topic: str | None, others: list[str], option: str) -> list[str]:
    return [f"the {what} are those of {topic}; {option} chooses others: {', '.join(others)}"] if others else []


def _left(poses: list[str]) -> list[str]:
    if not poses:
        return []
    return [f"poses on {', '.join(poses)} are not taken for the truth; --groundtruth-topic chooses some"]


@dataclass(frozen=True)
class _Lens:
    """What took the images, where that is known from, and how it sits on the body."""

    camera: Camera
    source: str
    body_T_cam: Array | None = None
    time_offset_s: float | None = None
    remarks: tuple[str, ...] = ()


def _lens(bag: BagFile, image: str, contents: Contents, given: str | None) -> _Lens:
    beside = calibration_beside(bag.path.parent) if given is None else None
    if given is not None or beside is not None:
        option = given if given is not None else str(beside)
        found = inspect_calibration(option)
        said = () if beside is None else (f"the camera is from {beside.name}, which lies beside the bag",)
        return _described(found, contents, split_choice(option)[0], option, said)
    for topic, values in contents.cameras.items():
        rectified = "rect" in image.rpartition("/")[2]
        found = read_camera_info(values, Path(f"{bag.path}:{topic}"), rectified=rectified)
        return _described(found, contents, bag.path, topic, (f"the camera is from {topic}",))
    try:
        return _Lens(panorama_camera(contents.size, bag.path), "a full panorama")
    except (CalibrationError, DatasetError) as error:
        raise DatasetError(f"{error}. If a lens took it, say which: --calibration FILE") from None


def _described(found: Calibration, contents: Contents, path: Path, source: str, said: tuple[str, ...]) -> _Lens:
    camera = for_size(found.camera, contents.size, path)
    return _Lens(camera, source, found.body_T_cam, found.time_offset_s, said)


def _imu(contents: Contents, lens: _Lens) -> Imu | None:
    rows = contents.imu.values
    if not len(rows):
        return None
    mounting = lens.body_T_cam
    if mounting is None:
        mounting = contents.fixed.between(contents.imu.frame, contents.frame)
    times = rows[:, 0] - (lens.time_offset_s or 0.0)
    return Imu(times, rows[:, 1:4].copy(), rows[:, 4:7].copy(), T_body_cam=mounting)


def _offset(lens: _Lens) -> dict[str, Any]:
    return {} if lens.time_offset_s is None else {"imu_time_offset_s": lens.time_offset_s}


def _truth(contents: Contents, lens: _Lens, topic: str | None) -> tuple[Trajectory | None, list[str]]:
    """Camera poses with the truth's own stamps, and what had to be assumed."""
    rows = contents.truth.values
    if topic is None or not len(rows):
        return None, []
    body = Trajectory(rows[:, 0].copy(), make_pose(matrix_from_quaternion(rows[:, 4:8]), rows[:, 1:4]))
    frame = contents.truth.frame
    mounting = contents.fixed.between(frame, contents.frame)
    if mounting is not None:
        how = "the camera's" if frame == contents.frame else f"those of '{frame}', moved to the camera by /tf_static"
    elif lens.body_T_cam is not None:
        mounting, how = lens.body_T_cam, "the body's, moved to the camera by the calibration"
    else:
        how = (
            "taken for the camera's: nothing says how it sits on the body (a Kalibr --calibration with T_cam_imu does)"
        )
    moved = body if mounting is None else Trajectory(body.times, body.T_wc @ mounting)
    return moved, [f"true poses are from {topic}, {how}"]

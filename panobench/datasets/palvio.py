"""PALVIO: panoramic annular images, IMU and motion capture of LF-VIO, as ROS 1 bags or an extracted folder.

The ground truth of the bags is the body's pose. Sequences have the camera's, the body pose times ``body_T_cam``,
interpolated to the image times. IMU stamps are moved onto the camera's clock by the time offset; those of the motion
capture are used as they are, because its offset is not published.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.bag import BagFile, decode_image_message, parse_image_header
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.checksums import files_provenance
from panobench.datasets.folder import read_imu_csv
from panobench.datasets.image_sequence import ImageSequence, ImageSource, scaled_camera
from panobench.datasets.images import list_images, resize_image, to_rgb
from panobench.datasets.listing import children
from panobench.datasets.locate import choose_sequence
from panobench.datasets.palvio_calibration import PalvioCalibration, find_calibration
from panobench.datasets.palvio_mounting import mounted_by_gravity
from panobench.datasets.trajectory_io import check_times, read_tum
from panobench.datasets.truth import truth_at_frames
from panobench.errors import DatasetError
from panobench.geometry import make_pose, matrix_from_quaternion
from panobench.types import Imu, Trajectory

IMAGE = "sensor_msgs/msg/Image"
IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"


def _stamp(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


def camera_truth(body: Trajectory, calibration: PalvioCalibration) -> Trajectory:
    """Camera poses at the times of the motion capture, which has the body's."""
    return Trajectory(body.times, body.T_wc @ calibration.body_T_cam)


class PalvioBagSequence(FrameSequence):
    """One bag. Opening reads stamps, IMU and motion capture in one pass; images are read on demand."""

    def __init__(self, path: Path, name: str, calibration: PalvioCalibration, width: int | None) -> None:
        self.path, self.name, self.dataset = path, name, "palvio"
        self._bag = BagFile(path)
        self._connections = self._bag.connections(calibration.image_topic, IMAGE)
        stat = path.stat()
        contents = _contents(path, (stat.st_size, stat.st_mtime_ns), _Wanted.of(calibration))
        calibration, self._remarks = mounted_by_gravity(calibration, contents.imu)
        self.calibration = calibration
        self._where, self.times = contents.where, contents.times
        self._dropped = contents.dropped
        self._imu = None if contents.imu is None else _mounted(contents.imu, calibration)
        self._recorded = None if contents.body is None else camera_truth(contents.body, calibration)
        self._groundtruth = None if self._recorded is None else truth_at_frames(self._recorded, self.times)
        self.camera = scaled_camera(calibration.camera, width)

    def image(self, index: int) -> NDArray[np.uint8]:
        index = range(len(self))[index]
        data = self._bag.at(self._connections, *self._where[index])
        grey_or_rgb = decode_image_message(data, self.path, index)
        rgb = to_rgb(grey_or_rgb) if grey_or_rgb.ndim == 2 else grey_or_rgb
        return resize_image(rgb, self.camera.width, self.camera.height)

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._groundtruth

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self._recorded

    @property
    def imu(self) -> Imu | None:
        return self._imu

    def remarks(self) -> list[str]:
        return self._remarks

    def provenance(self) -> dict[str, Any]:
        return {
            "dataset": self.dataset,
            "sequence": self.name,
            "root": str(self.path),
            "native_size": [self.calibration.camera.width, self.calibration.camera.height],
            **_notes(self.calibration),
            "groundtruth_messages_out_of_order": self._dropped,
            **files_provenance([self.path]),
        }


@dataclass(frozen=True)
class _Contents:
    """What one pass over a bag finds. where: each image's receive time and rank among messages of that time."""

    where: list[tuple[int, int]]
    times: NDArray[np.float64]
    imu: Imu | None
    body: Trajectory | None
    dropped: int


@dataclass(frozen=True)
class _Wanted:
    """The part of the calibration on which the pass over a bag depends."""

    image_topic: str
    imu_topic: str
    groundtruth_topic: str
    size: tuple[int, int]
    time_offset_s: float

    @classmethod
    def of(cls, c: PalvioCalibration) -> _Wanted:
        size = (c.camera.width, c.camera.height)
        return cls(c.image_topic, c.imu_topic, c.groundtruth_topic, size, c.time_offset_s)


@lru_cache(maxsize=2)
def _contents(path: Path, version: tuple[int, int], wanted: _Wanted) -> _Contents:
    """One pass over the bag, cached: it takes seconds, and a bag is often opened at several widths.

    version: size and time of modification, so that a changed file is read again.
    """
    bag = BagFile(path)
    image_topic = wanted.image_topic
    kinds = {wanted.imu_topic: IMU, wanted.groundtruth_topic: ODOMETRY}
    connections = bag.connections(image_topic, IMAGE)
    for topic, kind in kinds.items():
        if topic in bag.topics:
            connections = connections + bag.connections(topic, kind)
    where: list[tuple[int, int]] = []
    stamps: list[float] = []
    rows: dict[str, list[tuple[float, ...]]] = {topic: [] for topic in kinds}
    for topic, received, data in bag.records(connections):
        if topic == image_topic:
            stamps.append(_checked_stamp(data, wanted.size, bag.path, len(stamps)))
            where.append((received, where[-1][1] + 1 if where and where[-1][0] == received else 0))
        else:
            message = bag.parse(data, topic, kinds[topic], len(rows[topic]))
            rows[topic].append(_imu_row(message) if kinds[topic] == IMU else _pose_row(message))
    if not where:
        raise DatasetError(f"topic '{image_topic}' has no image", bag.path)
    times = np.array(stamps)
    check_times(times, bag.path)
    samples, _ = _checked_rows(rows[wanted.imu_topic], 7, wanted.imu_topic, bag.path)
    poses, dropped = _checked_rows(rows[wanted.groundtruth_topic], 8, wanted.groundtruth_topic, bag.path)
    imu, body = None, None
    if len(samples):
        imu = Imu(samples[:, 0] - wanted.time_offset_s, samples[:, 1:4], samples[:, 4:7])
    if len(poses):
        body = Trajectory(poses[:, 0], make_pose(matrix_from_quaternion(poses[:, 4:8]), poses[:, 1:4]))
    return _Contents(where, times, imu, body, dropped)


def _checked_stamp(data: bytes, size: tuple[int, int], path: Path, frame: int) -> float:
    """An image's stamp in seconds. Raises DatasetError if its size is not the calibration's."""
    header = parse_image_header(data, path, frame)
    if (header.width, header.height) != size:
        raise DatasetError(
            f"the image is {header.width}x{header.height} pixels, the calibration is for {size[0]}x{size[1]}",
            path,
            frame=frame,
        )
    return header.stamp


def _imu_row(m: Any) -> tuple[float, ...]:
    w, a = m.angular_velocity, m.linear_acceleration
    return (_stamp(m), w.x, w.y, w.z, a.x, a.y, a.z)


def _pose_row(m: Any) -> tuple[float, ...]:
    p, q = m.pose.pose.position, m.pose.pose.orientation
    return (_stamp(m), p.x, p.y, p.z, q.w, q.x, q.y, q.z)


def _checked_rows(
    rows: list[tuple[float, ...]], columns: int, topic: str, path: Path
) -> tuple[NDArray[np.float64], int]:
    """Rows as a table (N, columns), those out of time order left out and counted. A quaternion ends an 8-column row."""
    table = np.array(rows, dtype=np.float64).reshape(-1, columns)
    bad = ~np.isfinite(table).all(axis=1)
    if columns == 8:
        bad |= np.abs(np.linalg.norm(table[:, 4:8], axis=1) - 1) > 0.05
    if bad.any():
        raise DatasetError(f"a message of '{topic}' holds NaN or no rotation", path, frame=int(np.argmax(bad)))
    keep = _increasing(table[:, 0])
    return table[keep], int(len(table) - keep.sum())


def _mounted(imu: Imu, calibration: PalvioCalibration) -> Imu:
    return replace(imu, T_body_cam=calibration.body_T_cam, gravity=calibration.gravity)


def _notes(calibration: PalvioCalibration) -> dict[str, Any]:
    return {
        "calibration": calibration.source,
        "evaluated_frame": "camera (body pose times body_T_cam)",
        "body_T_cam": calibration.body_T_cam.tolist(),
        "imu_time_offset_s": calibration.time_offset_s,
    }


def _increasing(times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether entries are later than all before them; recordings have repeated and late messages."""
    keep = np.ones(len(times), dtype=bool)
    if len(times):
        keep[1:] = times[1:] > np.maximum.accumulate(times)[:-1]
    return keep


class Palvio(Dataset):
    """Bags ``ROOT/ID01.bag`` ..., extracted folders ``ROOT/ID01/``, or one of them as ``ROOT`` itself."""

    name = "palvio"

    def _found(self) -> dict[str, Path]:
        root = self.root
        if root is None:
            raise DatasetError("dataset 'palvio' needs --root PATH")
        if root.is_file() or _is_extracted(root):
            return {root.stem if root.is_file() else root.resolve().name: root}
        if not root.is_dir():
            raise DatasetError("no such file or folder", root)
        found = {p.stem: p for p in children(root) if p.suffix == ".bag" and p.is_file()}
        found |= {p.name: p for p in children(root) if p.is_dir() and _is_extracted(p) and p.name not in found}
        if not found:
            raise DatasetError("no .bag file and no folder with images/ here", root)
        return found

    def sequences(self) -> list[str]:
        return list(self._found())

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        found = self._found()
        name = choose_sequence(self.name, sequence, found)
        path = found[name]
        calibration = find_calibration(path.parent if path.is_file() else path)
        if path.is_file():
            return PalvioBagSequence(path, name, calibration, width)
        return ImageSequence(_read_extracted(path, name, calibration), width)


def _is_extracted(folder: Path) -> bool:
    return (folder / "images").is_dir()


def _read_extracted(folder: Path, name: str, calibration: PalvioCalibration) -> ImageSource:
    """``images/<nanoseconds or seconds>.png``, optional ``groundtruth.tum`` (body poses) and ``imu.csv``."""
    images = list_images(folder / "images")
    if not images:
        raise DatasetError("the sequence is empty: images/ has no image", folder)
    stamps = []
    for path in images:
        try:
            value = float(path.stem)
        except ValueError:
            raise DatasetError("the file's name is not its time in nanoseconds or seconds", path) from None
        stamps.append(value * 1e-9 if value > 1e12 else value)
    order = np.argsort(stamps, kind="stable")
    times = np.array(stamps)[order]
    check_times(times, folder / "images")
    truth_path, imu_path = folder / "groundtruth.tum", folder / "imu.csv"
    imu = read_imu_csv(imu_path) if imu_path.is_file() else None
    calibration, remarks = mounted_by_gravity(calibration, imu)
    if imu is not None:
        imu = _mounted(replace(imu, times=imu.times - calibration.time_offset_s), calibration)
    recorded = camera_truth(read_tum(truth_path), calibration) if truth_path.is_file() else None
    return ImageSource(
        dataset="palvio",
        name=name,
        root=folder,
        native=calibration.camera,
        times=times,
        images=[images[i] for i in order],
        groundtruth=None if recorded is None else truth_at_frames(recorded, times),
        recorded_truth=recorded,
        imu=imu,
        inputs=tuple(p for p in (truth_path, imu_path) if p.is_file()),
        notes=_notes(calibration),
        remarks=tuple(remarks),
    )

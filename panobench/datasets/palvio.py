"""PALVIO: panoramic annular images, IMU and motion capture of LF-VIO, as ROS 1 bags or an extracted folder.

The ground truth of the bags is the body's pose; what is handed out is the camera's, body pose times
``body_T_cam``, interpolated to the image times. IMU stamps are moved onto the camera's clock by the time
offset; the motion capture's stamps are taken as they are (its offset is not published).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.bag import BagFile, ImageHeader, decode_image_message, parse_image_header
from panobench.datasets.base import Dataset, Sequence
from panobench.datasets.checksums import files_provenance
from panobench.datasets.folder import read_imu_csv
from panobench.datasets.image_sequence import ImageSequence, ImageSource, scaled_camera
from panobench.datasets.images import list_images, resize_image, to_rgb
from panobench.datasets.locate import choose_sequence
from panobench.datasets.palvio_calibration import PalvioCalibration, find_calibration
from panobench.datasets.trajectory_io import check_times, read_tum
from panobench.datasets.trajectory_match import interpolate_poses
from panobench.errors import DatasetError
from panobench.geometry import make_pose, matrix_from_quat
from panobench.types import Imu, Trajectory

IMAGE = "sensor_msgs/msg/Image"
IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
#: Poses are not interpolated across a longer hole in the motion capture.
MAX_GAP_S = 0.1


def _stamp(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


def camera_truth(body: Trajectory, times: NDArray[np.float64], calibration: PalvioCalibration) -> Trajectory | None:
    """Body poses -> camera poses at those of ``times`` that the motion capture covers; None if none."""
    found = interpolate_poses(Trajectory(body.times, body.T_wc @ calibration.body_T_cam), times, max_gap=MAX_GAP_S)
    return found if len(found) else None


class PalvioBagSequence(Sequence):
    """One bag. Opening reads it once (stamps, IMU, motion capture); images are read on demand."""

    def __init__(self, path: Path, name: str, calibration: PalvioCalibration, width: int | None) -> None:
        self.path, self.name, self.dataset, self.calibration = path, name, "palvio", calibration
        self._bag = BagFile(path)
        self._connections = self._bag.connections(calibration.image_topic, IMAGE)
        self._where, self.times = self._index_images()
        self.camera = scaled_camera(calibration.camera, width)
        self._imu = self._read_imu()
        self._dropped = 0
        body = self._read_body()
        self._groundtruth = None if body is None else camera_truth(body, self.times, calibration)

    def _index_images(self) -> tuple[list[tuple[int, int]], NDArray[np.float64]]:
        """Where each image is (receive time, how-many-th at that time), and the header stamps in seconds."""
        native = self.calibration.camera
        where: list[tuple[int, int]] = []
        stamps = []
        for frame, (received, data) in enumerate(self._bag.raw(self.calibration.image_topic, IMAGE)):
            header: ImageHeader = parse_image_header(data, self.path, frame)
            if (header.width, header.height) != (native.width, native.height):
                raise DatasetError(
                    f"the image is {header.width}x{header.height} pixels, "
                    f"the calibration is for {native.width}x{native.height}",
                    self.path,
                    frame=frame,
                )
            nth = where[-1][1] + 1 if where and where[-1][0] == received else 0
            where.append((received, nth))
            stamps.append(header.stamp_ns * 1e-9)
        if not where:
            raise DatasetError(f"topic '{self.calibration.image_topic}' has no image", self.path)
        times = np.array(stamps)
        check_times(times, self.path)
        return where, times

    def _read_imu(self) -> Imu | None:
        topic = self.calibration.imu_topic
        if topic not in self._bag.topics:
            return None
        rows = []
        for m in self._bag.messages(topic, IMU):
            w, a = m.angular_velocity, m.linear_acceleration
            rows.append((_stamp(m), w.x, w.y, w.z, a.x, a.y, a.z))
        table = np.array(rows, dtype=np.float64).reshape(-1, 7)
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if len(bad):
            raise DatasetError(f"a message of '{topic}' holds NaN", self.path, frame=int(bad[0]))
        table = table[_increasing(table[:, 0])]
        return Imu(table[:, 0] - self.calibration.time_offset_s, table[:, 1:4], table[:, 4:7])

    def _read_body(self) -> Trajectory | None:
        topic = self.calibration.groundtruth_topic
        if topic not in self._bag.topics:
            return None
        rows = []
        for m in self._bag.messages(topic, ODOMETRY):
            p, q = m.pose.pose.position, m.pose.pose.orientation
            rows.append((_stamp(m), p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        table = np.array(rows, dtype=np.float64).reshape(-1, 8)
        norm = np.linalg.norm(table[:, 4:8], axis=1)
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1) | (np.abs(norm - 1) > 0.05))
        if len(bad):
            raise DatasetError(f"a message of '{topic}' holds NaN or no rotation", self.path, frame=int(bad[0]))
        keep = _increasing(table[:, 0])
        self._dropped = int(len(table) - keep.sum())
        table = table[keep]
        if not len(table):
            return None
        return Trajectory(table[:, 0], make_pose(matrix_from_quat(table[:, 4:8]), table[:, 1:4]))

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
    def imu(self) -> Imu | None:
        return self._imu

    @property
    def body_T_cam(self) -> NDArray[np.float64] | None:
        return self.calibration.body_T_cam

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


def _notes(calibration: PalvioCalibration) -> dict[str, Any]:
    return {
        "calibration": calibration.source,
        "evaluated_frame": "camera (body pose times body_T_cam)",
        "imu_time_offset_s": calibration.time_offset_s,
    }


def _increasing(times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which entries are later than all before them; repeated and late messages happen in recordings."""
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
        found = {p.stem: p for p in sorted(root.iterdir()) if p.suffix == ".bag" and p.is_file()}
        found |= {p.name: p for p in sorted(root.iterdir()) if p.is_dir() and _is_extracted(p) and p.name not in found}
        if not found:
            raise DatasetError("no .bag file and no folder with images/ here", root)
        return found

    def sequences(self) -> list[str]:
        return list(self._found())

    def open(self, sequence: str | None = None, *, width: int | None = None) -> Sequence:
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
    if imu is not None:
        imu = Imu(imu.times - calibration.time_offset_s, imu.gyro, imu.accel)
    return ImageSource(
        dataset="palvio",
        name=name,
        root=folder,
        native=calibration.camera,
        times=times,
        images=[images[i] for i in order],
        groundtruth=camera_truth(read_tum(truth_path), times, calibration) if truth_path.is_file() else None,
        imu=imu,
        inputs=tuple(p for p in (truth_path, imu_path) if p.is_file()),
        notes=_notes(calibration),
        body_T_cam=calibration.body_T_cam,
    )

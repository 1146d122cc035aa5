"""PALVIO: panoramic annular images, IMU and motion capture of LF-VIO, as ROS 1 bags or an extracted folder.

The ground truth of the bags is the body's pose. Sequences have the camera's, the body pose times ``body_T_cam``,
interpolated to the image times. IMU stamps are moved onto the camera's clock by the time offset; those of the motion
capture are used as they are, because its offset is not published.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from panobench.datasets.bags.contents import Wanted, read_contents
from panobench.datasets.bags.files import BagFile
from panobench.datasets.bags.layout import find_bags, is_bag_folder
from panobench.datasets.bags.messages import IMAGES
from panobench.datasets.bags.sequence import BagSequence, BagSource
from panobench.datasets.bags.topics import named
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import list_images
from panobench.datasets.files.listing import children
from panobench.datasets.files.trajectory_io import check_times, read_tum
from panobench.datasets.files.truth import truth_at_frames
from panobench.datasets.formats.folder import read_imu_csv
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource
from panobench.datasets.found import FoundSequences
from panobench.datasets.palvio.calibration import PalvioCalibration, find_calibration
from panobench.datasets.palvio.mounting import mounted_by_gravity
from panobench.errors import DatasetError
from panobench.geometry import make_pose, matrix_from_quaternion
from panobench.types import Imu, Trajectory

#: Motion capture has its z axis up.
WORLD_UP = (0.0, 0.0, 1.0)


def camera_truth(body: Trajectory, calibration: PalvioCalibration) -> Trajectory:
    """Camera poses at the times of the motion capture, which has the body's."""
    return Trajectory(body.times, body.T_wc @ calibration.body_T_cam)


def _read_bag(path: Path, name: str, calibration: PalvioCalibration) -> BagSource:
    """Images, IMU and motion capture of one bag, of the calibration's topics. The bag may lack the last two."""
    bag = BagFile(path)
    imu_topic, truth_topic = (
        topic if topic in bag.topics else None for topic in (calibration.imu_topic, calibration.groundtruth_topic)
    )
    contents = read_contents(bag, Wanted(named(bag, calibration.image_topic, IMAGES), imu_topic, truth_topic))
    camera = calibration.camera
    if contents.size != (camera.width, camera.height):
        raise DatasetError(
            f"the images are {contents.size[0]}x{contents.size[1]} pixels, the calibration is for "
            f"{camera.width}x{camera.height}",
            path,
        )
    samples, poses = contents.imu.values, contents.truth.values
    imu, recorded = None, None
    if len(samples):
        imu = Imu(samples[:, 0] - calibration.time_offset_s, samples[:, 1:4], samples[:, 4:7])
    calibration, remarks = mounted_by_gravity(calibration, imu)
    if imu is None:
        remarks = [*remarks, f"there are no inertial samples on {calibration.imu_topic}"]
    if len(poses):
        body = Trajectory(poses[:, 0], make_pose(matrix_from_quaternion(poses[:, 4:8]), poses[:, 1:4]))
        recorded = camera_truth(body, calibration)
    return BagSource(
        dataset="palvio",
        up=WORLD_UP,
        name=name,
        bag=bag,
        topic=named(bag, calibration.image_topic, IMAGES),
        contents=contents,
        native=camera,
        imu=None if imu is None else _mounted(imu, calibration),
        recorded=recorded,
        notes=_notes(calibration),
        remarks=tuple(remarks),
    )


def _mounted(imu: Imu, calibration: PalvioCalibration) -> Imu:
    return replace(imu, T_body_cam=calibration.body_T_cam, gravity=calibration.gravity)


def _notes(calibration: PalvioCalibration) -> dict[str, Any]:
    return {
        "calibration": calibration.source,
        "evaluated_frame": "camera (body pose times body_T_cam)",
        "body_T_cam": calibration.body_T_cam.tolist(),
        "imu_time_offset_s": calibration.time_offset_s,
    }


class Palvio(FoundSequences):
    """Bags ``ROOT/ID01.bag`` ..., extracted folders ``ROOT/ID01/``, or one of them as ``ROOT`` itself."""

    name = "palvio"

    def _found(self) -> dict[str, Path]:
        root = self.root
        if root is None:
            raise DatasetError("dataset 'palvio' needs --root PATH")
        if not root.exists():
            raise DatasetError("no such file or folder", root)
        if root.is_dir() and _is_extracted(root):
            return {root.resolve().name: root}
        found = find_bags(root, levels=0)
        if root.is_dir():
            found |= {p.name: p for p in children(root) if p.is_dir() and _is_extracted(p) and p.name not in found}
        if not found:
            raise DatasetError("no bag and no folder with images/ here", root)
        return found

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, path = self._choose(sequence)
        calibration = find_calibration(path if _is_extracted(path) else path.parent)
        if path.is_file() or is_bag_folder(path):
            return BagSequence(_read_bag(path, name, calibration), width)
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
        up=WORLD_UP,
        recorded_truth=recorded,
        imu=imu,
        inputs=tuple(p for p in (truth_path, imu_path) if p.is_file()),
        notes=_notes(calibration),
        remarks=tuple(remarks),
    )

"""TUM-VI: fisheye images, IMU and motion capture in EuRoC's layout.

Schubert et al., "The TUM VI Benchmark for Evaluating Visual-Inertial Odometry" (IROS 2018). ``SEQUENCE/mav0/cam0/``
(data.csv, data/*.png), ``mav0/imu0/data.csv``, ``mav0/mocap0/data.csv`` (poses of the IMU) and a Kalibr
``dso/camchain.yaml`` (or ``camchain.yaml``, ``camera.yaml`` in SEQUENCE, or EuRoC's ``mav0/cam0/sensor.yaml``).
Camera 0 is read; its poses are the IMU's times the extrinsics, interpolated to the image times.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.calibration import Calibration, inspect_calibration
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.imu_table import read_imu_table
from panobench.datasets.files.natural import natural_paths
from panobench.datasets.files.trajectory_io import check_times, parse_floats, read_euroc_csv, read_rows
from panobench.datasets.files.truth import truth_at_frames
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource
from panobench.datasets.found import FoundSequences
from panobench.errors import CalibrationError, DatasetError
from panobench.masks.files import mask_of_folder
from panobench.types import Imu, Trajectory

_CALIBRATIONS = ("dso/camchain.yaml", "camchain.yaml", "mav0/camchain.yaml", "camera.yaml", "mav0/cam0/sensor.yaml")
_TRUTHS = ("mav0/mocap0/data.csv", "mav0/state_groundtruth_estimate0/data.csv")


class TumVi(FoundSequences):
    """Sequences below ``root``; or ``root`` is one."""

    name = "tum-vi"

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset 'tum-vi' needs --root PATH")
        if (self.root / "mav0").is_dir():
            return {self.root.resolve().name: self.root}
        found = {p.parent.name: p.parent for p in natural_paths(self.root.glob("*/mav0"))}
        if not found:
            raise DatasetError("no TUM-VI sequence here: SEQUENCE/mav0/cam0/data.csv is expected", self.root)
        return found

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        return ImageSequence(_read(place, name), width)


def _read(folder: Path, name: str) -> ImageSource:
    calibration, calibration_path = _calibration(folder)
    times, images = _image_list(folder / "mav0/cam0")
    mask = mask_of_folder([folder], (calibration.camera.width, calibration.camera.height))
    native = mask.on(calibration.camera)
    truth_path = next((folder / p for p in _TRUTHS if (folder / p).is_file()), None)
    imu_path = folder / "mav0/imu0/data.csv"
    imu = _read_imu(imu_path, calibration) if imu_path.is_file() else None
    recorded = None if truth_path is None else _camera_truth(truth_path, calibration, calibration_path)
    inputs = [p for p in (calibration_path, truth_path, imu_path) if p is not None and p.is_file()]
    return ImageSource(
        dataset="tum-vi",
        name=name,
        root=folder,
        native=native,
        times=times,
        images=images,
        groundtruth=None if recorded is None else truth_at_frames(recorded, times),
        recorded_truth=recorded,
        imu=imu,
        inputs=(*inputs, *mask.files()),
        notes={"evaluated_frame": "camera 0", "calibration_notes": calibration.notes, **mask.about()},
        remarks=mask.remarks,
    )


def _calibration(folder: Path) -> tuple[Calibration, Path]:
    path = next((folder / p for p in _CALIBRATIONS if (folder / p).is_file()), None)
    if path is None:
        raise DatasetError(f"no calibration: one of {', '.join(_CALIBRATIONS)} is expected", folder)
    return inspect_calibration(path), path


def _image_list(cam: Path) -> tuple[NDArray[np.float64], list[Path]]:
    """Times in seconds and image files of data.csv (time in ns, file name)."""
    path = cam / "data.csv"
    stamps, images, lines = [], [], []
    for row in read_rows(path, delimiter=","):
        if len(row.fields) != 2 or "/" in row.fields[1]:
            raise DatasetError("expected: time in ns, file name", path, line=row.line)
        stamps += parse_floats(row, row.fields[:1], path, "time in ns, file name")
        image = cam / "data" / row.fields[1]
        if not image.is_file():
            raise DatasetError(f"image '{row.fields[1]}' is missing", path, line=row.line)
        images.append(image)
        lines.append(row.line)
    if not images:
        raise DatasetError("the sequence is empty: the file has no row", path)
    times = np.array(stamps) * 1e-9
    check_times(times, path, lines)
    return times, images


def _read_imu(path: Path, calibration: Calibration) -> Imu:
    imu = read_imu_table(path, unit_s=1e-9)
    return replace(imu, times=imu.times - (calibration.time_offset_s or 0.0), T_body_cam=calibration.body_T_cam)


def _camera_truth(path: Path, calibration: Calibration, source: Path) -> Trajectory:
    """The camera's poses as recorded: the body's, with the camera's place on it."""
    if calibration.body_T_cam is None:
        raise CalibrationError(
            "the camera's place on the IMU (T_cam_imu) is missing; the ground truth needs it", source
        )
    body = read_euroc_csv(path)
    return Trajectory(body.times, body.T_wc @ calibration.body_T_cam)

"""``hilti-360``: two fisheye lenses, an IMU and laser-scanned poses on construction sites.

A sequence has the pictures of both lenses as a rig, and stitched to a panorama for methods that take one centre. The
ground truth of the recordings is cam0's pose in the floor plan's frame, z up; a sequence has that of the rig.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig import Rig, seen_in_panorama
from panobench.cameras.stitching import Stitcher
from panobench.datasets.bags.contents import Contents, Wanted, read_contents
from panobench.datasets.bags.files import BagFile
from panobench.datasets.bags.images import decode_image_message
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.checksums import files_provenance
from panobench.datasets.files.images import resize_image
from panobench.datasets.files.trajectory_io import read_tum
from panobench.datasets.files.truth import truth_at_frames
from panobench.datasets.formats.image_folder import for_size
from panobench.datasets.found import FoundSequences
from panobench.datasets.hilti.calibration import (
    GRAVITY,
    IMAGE_TOPICS,
    IMU_TOPIC,
    UNJUDGED_S,
    HiltiCalibration,
    chain_calibration,
    operator_mask,
    published_calibration,
)
from panobench.datasets.hilti.layout import bag_of, find_runs, truth_of
from panobench.errors import DatasetError, UsageError
from panobench.types import Imu, Trajectory

Array = NDArray[np.float64]

#: Pictures of the two lenses whose stamps differ by no more are of the same moment, s.
TOGETHER_S = 0.005
#: Things this far away are stitched without a seam, metres.
STITCHED_AT_M = 2.0


@dataclass(frozen=True)
class Recording:
    """A run as read: the bag, both topics' contents, and which image of each makes a frame (N, 2)."""

    name: str
    bag: BagFile
    contents: tuple[Contents, Contents]
    pairs: NDArray[np.intp]
    calibration: HiltiCalibration
    imu: Imu | None
    truth: Trajectory | None
    inputs: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()


class HiltiSequence(FrameSequence):
    """Frames for which both lenses have a picture. ``width``: of the panorama; the lenses' pictures are half as wide.

    Reading is thread-safe.
    """

    dataset = "hilti-360"

    def __init__(self, recording: Recording, width: int | None) -> None:
        width = 2 * recording.contents[0].size[0] if width is None else width
        if width % 2:
            raise UsageError(f"--width {width}: a panorama's width must be even")
        self.recording, self.name = recording, recording.name
        self.times = recording.contents[0].times[recording.pairs[:, 0]]
        plain = ErpCamera(width, width // 2)
        rig = recording.calibration.scaled(width // 2).rig()
        self._stitcher = Stitcher(rig, plain, distance_m=STITCHED_AT_M)
        hidden = operator_mask(plain)
        self.camera = plain.with_mask(self._stitcher.valid & hidden)
        self._rig = rig.with_masks(seen_in_panorama(rig, plain, hidden))
        self._truth = None if recording.truth is None else truth_at_frames(recording.truth, self.times)
        self._last: tuple[int, tuple[NDArray[np.uint8], ...]] | None = None
        self._lock = threading.Lock()

    @property
    def rig(self) -> Rig | None:
        return self._rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        index = range(len(self))[index]
        with self._lock:
            if self._last is None or self._last[0] != index:
                pictures = tuple(self._picture(k, index) for k in range(2))
                self._last = (index, pictures)
            return self._last[1]

    def _picture(self, lens: int, index: int) -> NDArray[np.uint8]:
        bag, contents = self.recording.bag, self.recording.contents[lens]
        place = contents.places[int(self.recording.pairs[index, lens])]
        rgb = decode_image_message(bag.parse(bag.at(IMAGE_TOPICS[lens], place), index), bag.path, index)
        camera = self._rig.lenses[lens].camera
        return resize_image(rgb, camera.width, camera.height)

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._stitcher.image(self.lens_images(index))

    @property
    def enlargement(self) -> float:
        return max(1.0, self._rig.lenses[0].camera.width / self.recording.contents[0].size[0])

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._truth

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self.recording.truth

    @property
    def world_up(self) -> Array | None:
        return np.array([0.0, 0.0, 1.0])

    @property
    def imu(self) -> Imu | None:
        return self.recording.imu

    def remarks(self) -> list[str]:
        return [*self.recording.remarks]

    def provenance(self) -> dict[str, Any]:
        r = self.recording
        return {
            "dataset": self.dataset,
            "sequence": r.name,
            "root": str(r.bag.path),
            "native_size": list(r.contents[0].size),
            "bag": r.bag.kind,
            "calibration": r.calibration.source,
            "evaluated_frame": "midway between the lenses, cam0's axes turned upright",
            "T_cam0_rig": r.calibration.T_cam0_rig.tolist(),
            "imu_time_offset_s": r.calibration.time_offset_s,
            **files_provenance([*r.inputs, *r.bag.files]),
        }


class Hilti360(FoundSequences):
    """The organisers' folders below ``root``, or one run's folder."""

    name = "hilti-360"
    takes = frozenset({"calibration"})

    def _found(self) -> dict[str, Path]:
        if self.root is None:
            raise DatasetError("dataset 'hilti-360' needs --root PATH")
        found = find_runs(self.root)
        if not found:
            raise DatasetError("no run here: floor_X/YYYY-MM-DD/run_Z/rosbag/rosbag.db3", self.root)
        return found

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name, place = self._choose(sequence)
        given = self.given.calibration
        calibration = published_calibration() if given is None else chain_calibration(Path(given))
        return HiltiSequence(read_recording(place, name, calibration), width)


def read_recording(run: Path, name: str, calibration: HiltiCalibration) -> Recording:
    """The run in a folder. Raises DatasetError for topics that are missing and pictures of another shape."""
    bag = BagFile(bag_of(run))
    imu_topic = IMU_TOPIC if IMU_TOPIC in bag.topics else None
    front = read_contents(bag, Wanted(IMAGE_TOPICS[0], imu_topic))
    back = read_contents(bag, Wanted(IMAGE_TOPICS[1]))
    if front.size != back.size:
        raise DatasetError(f"the lenses' pictures differ in size: {front.size} and {back.size}", bag.path)
    size, cameras = front.size, calibration.cameras
    if size != (cameras[0].width, cameras[0].height):
        for_size(cameras[0], size, bag.path)  # refuses other proportions
        calibration = calibration.scaled(size[0])
    pairs = paired(front.times, back.times)
    if not len(pairs):
        raise DatasetError("no two pictures of cam0 and cam1 have the same stamp", bag.path)
    alone = len(front.times) + len(back.times) - 2 * len(pairs)
    truth_path = truth_of(run, name)
    begin = float(front.times[0])
    said = [f"{alone} pictures of one lens have none of the other and are left out"] if alone else []
    for lens, contents in enumerate((front, back)):
        said += [f"cam{lens}: {line}" for line in contents.remarks()]
    if truth_path is not None:
        said.append(f"the first {UNJUDGED_S:g} s are not judged, as the organisers do not")
    if imu_topic is None or not len(front.imu.values):
        said.append(f"there are no inertial samples on {IMU_TOPIC}")
    return Recording(
        name,
        bag,
        (front, back),
        pairs,
        calibration,
        _imu(front, calibration),
        None if truth_path is None else judged_truth(read_tum(truth_path), calibration, begin),
        () if truth_path is None else (truth_path,),
        tuple(said),
    )


def paired(first: Array, second: Array) -> NDArray[np.intp]:
    """Indices (N, 2) of times of both that differ by at most TOGETHER_S, each used once."""
    if not len(second):
        return np.zeros((0, 2), dtype=np.intp)
    nearest = np.minimum(np.searchsorted(second, first - TOGETHER_S), len(second) - 1)
    close = np.flatnonzero(np.abs(second[nearest] - first) <= TOGETHER_S)
    _, once = np.unique(nearest[close], return_index=True)
    return np.stack([close[once], nearest[close[once]]], axis=1)


def judged_truth(cam0: Trajectory, calibration: HiltiCalibration, begin: float) -> Trajectory:
    """The rig's poses from cam0's, without those of the first seconds after ``begin``, which are not judged."""
    kept = cam0.select(np.flatnonzero(cam0.times >= begin + UNJUDGED_S))
    return Trajectory(kept.times, kept.T_wc @ calibration.T_cam0_rig)


def _imu(contents: Contents, calibration: HiltiCalibration) -> Imu | None:
    rows = contents.imu.values
    if not len(rows):
        return None
    times = rows[:, 0] - calibration.time_offset_s
    return Imu(times, rows[:, 1:4].copy(), rows[:, 4:7].copy(), T_body_cam=calibration.T_imu_rig, gravity=GRAVITY)

"""Makes a run of the challenge from a built-in room: its topics, types, calibration, stamps and layout of folders.

Somebody walks through the room with the camera (``capture.stroll``); both lenses are rendered from their own centres,
row by row, with the operator in view; the IMU is simulated on the same motion (``capture.imu``) with the published
noise. Ground truth is exact.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.capture.imu import BodyMotion, ImuNoise, ImuSamples, sample_times, simulate_imu
from panobench.capture.lens_studio import LensStudio
from panobench.capture.parts import Parts
from panobench.capture.stroll import StrollOptions, stroll
from panobench.datasets.bags.images import COMPRESSED
from panobench.datasets.bags.making import MessageMaker
from panobench.datasets.bags.messages import IMU
from panobench.datasets.files.trajectory_io import write_tum
from panobench.datasets.hilti.calibration import (
    GRAVITY,
    IMAGE_RATE_HZ,
    IMAGE_TOPICS,
    IMU_RATE_HZ,
    IMU_TOPIC,
    NOISE,
    STAMP_SHIFT_S,
    HiltiCalibration,
    published_calibration,
)
from panobench.datasets.hilti.layout import RUN_NAME
from panobench.errors import UnknownNameError, UsageError
from panobench.geometry import invert_pose
from panobench.rooms.kinds import KINDS
from panobench.rooms.options import parse_name
from panobench.rooms.render import worker_count
from panobench.rooms.world import World
from panobench.types import Trajectory
from panobench.writing import write_whole, writing

Array = NDArray[np.float64]

#: Readout of the rows that is simulated; the organisers do not publish the camera's, s.
READOUT_S = 0.016
#: A floor that the organisers do not have: no row of a report looks like one of theirs.
SYNTHETIC_RUN = "floor_synthetic_2026-01-01_run_1"
#: The first sample of the IMU precedes the first image by this, as in the recordings, s.
_EARLY_S = 0.1
_QUALITY = 92


@dataclass(frozen=True)
class HiltiSynthOptions:
    """run: its name. room: a built-in room. width: of the lenses' pictures (None: 1472). rate: images a second.

    operator: share of the sphere that the operator hides. noise: of the IMU. sensor_noise: of pixels, full scale 1.
    """

    run: str = SYNTHETIC_RUN
    room: str = "loop"
    width: int | None = None
    rate: float = IMAGE_RATE_HZ
    readout_s: float = READOUT_S
    operator: float = 0.1
    walk: StrollOptions = field(default_factory=StrollOptions)
    noise: ImuNoise = NOISE
    sensor_noise: float = 0.9 / 255


@dataclass(frozen=True)
class MadeRun:
    """Where the run and its ground truth are, and how many frames it has."""

    folder: Path
    truth: Path
    frames: int


def write_hilti_run(out: Path, options: HiltiSynthOptions, progress: Callable[[int], None] = lambda _: None) -> MadeRun:
    """Write OUT/floor_X/YYYY-MM-DD/run_Z/rosbag, beside it truth.json, and OUT/groundtruth/NAME.txt.

    truth.json has what the bag does not tell: readout, biases, options. Raises UsageError for a run that is there
    already, and for options that make none.
    """
    match = RUN_NAME.fullmatch(options.run)
    if match is None:
        raise UsageError(f"--run {options.run}: the name is floor_X_YYYY-MM-DD_run_Z")
    frames = int(options.walk.seconds * options.rate)
    if frames < 4:
        raise UsageError(f"a run needs at least 4 frames, not {frames}")
    folder = out / f"floor_{match[1]}" / match[2] / f"run_{match[3]}"
    truth = out / "groundtruth" / f"{options.run}.txt"
    if folder.exists():
        raise UsageError(f"{folder} exists already; remove it or choose another --out or --run")
    calibration = published_calibration()
    if options.width is not None:
        calibration = calibration.scaled(options.width)
    kind, chosen = parse_name(options.room)
    if kind not in KINDS:
        raise UnknownNameError("built-in room", kind, KINDS)
    world = World(kind, chosen.seed, chosen.frames)
    world.prepare()
    motion = BodyMotion(stroll(world.plan.walk, options.walk))
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    times = np.arange(frames) / options.rate
    with writing(folder):
        partial.mkdir(parents=True)
        try:
            imu = _imu(motion, calibration, float(times[-1]), options)
            _write_bag(partial / "rosbag", _pictures(world, motion, calibration, times, options), times, imu, progress)
            write_whole(partial / "truth.json", json.dumps(_facts(options, imu), indent=1) + "\n")
            truth.parent.mkdir(exist_ok=True)
            T_map_cam0 = motion.poses(times) @ invert_pose(calibration.T_cam0_rig)
            write_tum(truth, Trajectory(times + STAMP_SHIFT_S, T_map_cam0))
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return MadeRun(folder, truth, frames)


def _imu(motion: BodyMotion, calibration: HiltiCalibration, last: float, options: HiltiSynthOptions) -> ImuSamples:
    """Samples on the camera's clock, in the IMU's axes."""
    body = BodyMotion(Trajectory(motion.times, motion.poses(motion.times) @ invert_pose(calibration.T_imu_rig)))
    times = sample_times(-_EARLY_S, last + _EARLY_S, IMU_RATE_HZ)
    rng = np.random.default_rng([options.walk.seed, 84])
    return simulate_imu(body, times, IMU_RATE_HZ, np.array([0.0, 0.0, 1.0]), options.noise, rng, GRAVITY)


def _pictures(
    world: World, motion: BodyMotion, calibration: HiltiCalibration, times: Array, options: HiltiSynthOptions
) -> Iterator[tuple[bytes, bytes]]:
    """JPEG files of both lenses, frame by frame."""
    parts = Parts(operator=options.operator, rolling=options.readout_s, seed=options.walk.seed)
    studios = [
        LensStudio(world, lens, motion, parts, times, options.sensor_noise, 2 * options.walk.seed + k)
        for k, lens in enumerate(calibration.rig(options.readout_s).lenses)
    ]
    for studio in studios:
        studio.prepare()

    def shoot(index: int) -> tuple[bytes, bytes]:
        front, back = (_jpeg(studio.image(index)) for studio in studios)
        return front, back

    ahead = 4 * worker_count()
    with ThreadPoolExecutor(worker_count()) as pool:
        for first in range(0, len(times), ahead):
            yield from pool.map(shoot, range(first, min(first + ahead, len(times))))


def _jpeg(rgb: NDArray[np.uint8]) -> bytes:
    _, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return bytes(data.tobytes())


def _facts(options: HiltiSynthOptions, imu: ImuSamples) -> dict[str, Any]:
    some = slice(None, None, int(IMU_RATE_HZ))
    return {
        "generator": "panobench synth hilti-360",
        "options": asdict(options),
        "time_offset_s": published_calibration().time_offset_s,
        "gravity": GRAVITY,
        "bias_times": (imu.times[some] + STAMP_SHIFT_S).tolist(),
        "gyro_bias": imu.gyro_bias[some].tolist(),
        "accel_bias": imu.accel_bias[some].tolist(),
    }


def _write_bag(
    path: Path,
    pictures: Iterator[tuple[bytes, bytes]],
    times: Array,
    imu: ImuSamples,
    progress: Callable[[int], None],
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    make = MessageMaker(store.types)
    stamps = imu.times + STAMP_SHIFT_S + published_calibration().time_offset_s
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        images = [writer.add_connection(topic, COMPRESSED, typestore=store) for topic in IMAGE_TOPICS]
        inertial = writer.add_connection(IMU_TOPIC, IMU[0], typestore=store)
        written = 0

        def write_imu(until: float) -> int:
            k = written
            while k < len(stamps) and stamps[k] <= until:
                stamp = _nanoseconds(float(stamps[k]))
                message = make.imu(make.header(stamp, "imu"), imu.gyro[k], imu.accel[k])
                writer.write(inertial, stamp, store.serialize_cdr(message, IMU[0]))
                k += 1
            return k

        for t, both in zip(times + STAMP_SHIFT_S, pictures):
            written = write_imu(float(t))
            stamp = _nanoseconds(float(t))
            for k, data in enumerate(both):
                message = make.compressed_image(make.header(stamp, f"cam{k}"), data, "jpeg")
                writer.write(images[k], stamp, store.serialize_cdr(message, COMPRESSED))
            progress(1)
        write_imu(np.inf)


def _nanoseconds(time: float) -> int:
    return round(time * 1e9)

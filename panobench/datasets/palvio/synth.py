"""Makes a bag with PALVIO's topics, types and calibration from any panoramic sequence with ground truth.

The published bags cannot be shipped. This one lets users try the pipeline, and tests use it. Splines through the poses
give body poses and IMU samples (``capture.imu``).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import write_calibration
from panobench.cameras.reproject import Reprojector
from panobench.cameras.views import upright_rotation
from panobench.capture.imu import BodyMotion, ImuNoise, sample_times, simulate_imu
from panobench.datasets.bags.images import RAW
from panobench.datasets.bags.making import MessageMaker
from panobench.datasets.bags.messages import IMU, ODOMETRY
from panobench.datasets.base import FrameSequence
from panobench.datasets.palvio.calibration import OVERRIDE, PalvioCalibration, published_calibration
from panobench.errors import UsageError
from panobench.geometry import invert_pose, make_pose, quaternion_from_matrix
from panobench.types import Trajectory
from panobench.writing import write_whole, writing

Array = NDArray[np.float64]
#: Of a walk through a room, as PALVIO's camera.
IMAGE_RATE_HZ = 15.0
CAMERA_FILE = "palvio_camera.yaml"
#: Pose of a camera that looks ahead on the body, whose axes are x forward, y left, z up.
LOOKING_AHEAD = make_pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.05, 0.0, 0.03]))
#: At 200 Hz 0.002 rad/s and 0.02 m/s^2 per sample, as flight controllers have.
NOISE = ImuNoise(gyro=0.002 / np.sqrt(200), accel=0.02 / np.sqrt(200))


@dataclass(frozen=True)
class BagOptions:
    """frames: number of images (None: all). width: of the images (None: 1280). noise: of the IMU; none is published.

    camera: another than PALVIO's, which looks ahead (x of the body) unless it is annular; ``width`` is its own then.
    body_T_cam: pose of the camera on the body (None: the calibration's, or what "looks ahead" says).
    """

    frames: int | None = None
    width: int | None = None
    camera: Camera | None = None
    seed: int = 0
    start_time_s: int = 1_700_000_000
    imu_rate_hz: float = 200.0
    truth_rate_hz: float = 100.0
    noise: ImuNoise = NOISE
    body_T_cam: Array | None = None


def upward_axis(T_wc: Array) -> Array:
    """The world axis, a signed unit vector, that is nearest to the cameras' mean up direction, -y."""
    mean = -T_wc[:, :3, 1].mean(axis=0)
    axis = int(np.argmax(np.abs(mean)))
    return np.asarray(np.sign(mean[axis]) * np.eye(3)[axis])


def scaled_calibration(width: int | None) -> PalvioCalibration:
    """PALVIO's calibration for images of ``width`` (None: its own)."""
    full = published_calibration()
    return full if width is None else replace(full, camera=full.camera.scaled(width))


def write_palvio_bag(
    path: Path,
    sequence: FrameSequence,
    options: BagOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Path:
    """Write ``path`` (a .bag) from a sequence with ground truth at every frame; returns ``path``.

    A generator renders for the camera, other images are reprojected. For other cameras than PALVIO's, and other
    widths than 1280, palvio.yaml with the calibration is written beside the bag, which appears complete or not at all.
    Raises UsageError if it exists or if the sequence has too little ground truth.
    """
    options = options or BagOptions()
    if path.suffix != ".bag":
        raise UsageError(f"--out {path}: the file's name must end in .bag")
    if path.exists():
        raise UsageError(f"{path} exists already; remove it or choose another --out")
    calibration = scaled_calibration(options.width)
    if options.camera is not None and options.camera.kind != "pal":
        calibration = replace(calibration, camera=options.camera, body_T_cam=LOOKING_AHEAD)
    elif options.camera is not None:
        calibration = replace(calibration, camera=options.camera)
    if options.body_T_cam is not None:
        calibration = replace(calibration, body_T_cam=options.body_T_cam)
    motion, frames, up = _plan(sequence, options, calibration)
    partial = path.with_name(path.name + ".partial")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        try:
            _write(partial, sequence, frames, motion, up, calibration, options, progress)
            if options.camera is not None or calibration.camera.width != published_calibration().camera.width:
                write_calibration(calibration.camera, path.parent / CAMERA_FILE)
                mounting = "" if options.camera is None else f"body_T_cam: {calibration.body_T_cam.tolist()}\n"
                write_whole(path.parent / OVERRIDE, f"camera: {CAMERA_FILE}\n{mounting}")
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    return path


def _plan(
    sequence: FrameSequence, options: BagOptions, calibration: PalvioCalibration
) -> tuple[BodyMotion, list[int], Array]:
    """Body motion over the frames chosen, their indices, and the world's up axis."""
    truth = sequence.groundtruth
    n = len(sequence) if options.frames is None else min(options.frames, len(sequence))
    if n < 4:
        raise UsageError(f"a bag needs at least 4 frames, not {n}")
    if truth is None or not np.isin(sequence.times[:n], truth.times).all():
        raise UsageError(f"sequence '{sequence.name}' has no ground truth for its first {n} frames")
    truth = truth.select(np.searchsorted(truth.times, sequence.times[:n]))
    R_pal_source = upright_rotation(calibration.camera).T @ upright_rotation(sequence.camera)
    T_w_pal = truth.T_wc @ make_pose(R_pal_source.T, np.zeros(3))
    T_w_body = T_w_pal @ invert_pose(calibration.body_T_cam)
    upright = truth.T_wc @ make_pose(upright_rotation(sequence.camera).T, np.zeros(3))
    return BodyMotion(Trajectory(truth.times, T_w_body)), list(range(n)), upward_axis(upright)


def _pictures(sequence: FrameSequence, camera: Camera) -> Callable[[int], NDArray[np.uint8]]:
    """The images of ``camera``, upright as the sequence's own."""
    R = upright_rotation(camera).T @ upright_rotation(sequence.camera)
    rendered = sequence.rendered_by(camera, R)
    if rendered is not None:
        return rendered.image
    reprojector = Reprojector(sequence.camera, camera, R)
    return lambda index: reprojector.image(sequence.image(index))


def _write(
    path: Path,
    sequence: FrameSequence,
    frames: list[int],
    motion: BodyMotion,
    up: Array,
    calibration: PalvioCalibration,
    options: BagOptions,
    progress: Callable[[int], None],
) -> None:
    import cv2
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    make = MessageMaker(store.types)
    picture = _pictures(sequence, calibration.camera)
    begin, end = float(motion.times[0]), float(motion.times[-1])
    t_imu = sample_times(begin, end, options.imu_rate_hz)
    t_truth = sample_times(begin, end, options.truth_rate_hz)
    rng = np.random.default_rng(options.seed)
    imu = simulate_imu(motion, t_imu, options.imu_rate_hz, up, options.noise, rng, calibration.gravity)
    body = motion.poses(t_truth)

    # The IMU's clock is ahead of the camera's by the time offset.
    events: list[tuple[float, int, int]] = [(t + calibration.time_offset_s, 0, k) for k, t in enumerate(t_imu)]
    events += [(t, 1, k) for k, t in enumerate(t_truth)]
    events += [(float(sequence.times[i]), 2, i) for i in frames]
    topics = (
        (calibration.imu_topic, IMU[0]),
        (calibration.groundtruth_topic, ODOMETRY),
        (calibration.image_topic, RAW),
    )
    with Writer(path) as writer:
        connections = [writer.add_connection(topic, kind, typestore=store) for topic, kind in topics]
        for time, kind, k in sorted(events):
            stamp = options.start_time_s * 10**9 + round(time * 1e9)
            if kind == 0:
                message = make.imu(make.header(stamp, "base_link", k), imu.gyro[k], imu.accel[k])
            elif kind == 1:
                message = _odometry(make, make.header(stamp, "world", k), body[k])
            else:
                grey = np.asarray(cv2.cvtColor(picture(k), cv2.COLOR_RGB2GRAY), dtype=np.uint8)
                message = make.grey_image(make.header(stamp, "pal", k), grey)
                progress(1)
            writer.write(connections[kind], stamp, store.serialize_ros1(message, topics[kind][1]))


def _odometry(make: MessageMaker, header: Any, T: Array) -> Any:
    """The body's pose ``T`` as PALVIO's recordings hold it."""
    types = make.types
    w, x, y, z = (float(c) for c in quaternion_from_matrix(T[:3, :3]))
    point = types["geometry_msgs/msg/Point"](x=float(T[0, 3]), y=float(T[1, 3]), z=float(T[2, 3]))
    turned = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turned)
    still = make.vector(np.zeros(3))
    return types[ODOMETRY](
        header=header,
        child_frame_id="pal",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            twist=types["geometry_msgs/msg/Twist"](linear=still, angular=still), covariance=np.zeros(36)
        ),
    )

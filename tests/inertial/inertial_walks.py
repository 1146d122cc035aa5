"""Motion with exact poses and inertial samples, with noise, walking biases and visual poses as a method gives them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.palvio.synth import BodyMotion
from panobench.geometry import Sim3, make_pose, so3_exp
from panobench.inertial.samples import ImuNoise
from panobench.inertial.visual import VisualPoses
from panobench.types import Imu, Trajectory

Array = NDArray[np.float64]
#: As published for the Hilti x Trimble 360 rig.
PUBLISHED = ImuNoise(0.00047032, 0.002859, 0.00036433, 0.0013004)
UP = np.array([0.0, 0.0, 1.0])
GRAVITY = 9.80766
#: The camera on the body: a rotation that is no exchange of axes, a lever arm of some centimetres.
MOUNTING = make_pose(so3_exp(np.array([0.3, -1.1, 1.4])), np.array([0.021, 0.014, -0.012]))


def walk(seconds: float = 60.0, *, still_s: float = 0.0, speed: float = 1.0, seed: int = 0) -> BodyMotion:
    """A walk at ``speed`` m/s through rooms, z up: strides at 1.8 Hz, sway, turns and glances; still at first."""
    rng = np.random.default_rng(seed)
    t = np.arange(-1.0, seconds + 1.0, 0.02)
    going = np.clip((t - still_s) / 1.0, 0.0, 1.0) if still_s > 0 else np.ones_like(t)
    going = going**2 * (3 - 2 * going)
    phase = rng.uniform(0, 6, 8)
    walked = np.cumsum(going * 0.02)
    heading = 1.3 * np.sin(0.21 * walked + phase[0]) + 2.0 * np.sin(0.083 * walked + phase[1])
    velocity = speed * going[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    xy = np.cumsum(velocity * 0.02, axis=0)
    sway = 0.02 * going * np.sin(2 * np.pi * 0.9 * walked + phase[2])
    xy += sway[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)])
    z = 1.6 + 0.038 * going * np.sin(2 * np.pi * 1.8 * walked + phase[3])
    yaw = heading + going * 0.35 * np.sin(0.9 * walked + phase[4])
    pitch = going * (0.05 * np.sin(2 * np.pi * 1.8 * walked + phase[5]) + 0.12 * np.sin(0.4 * walked + phase[6]))
    roll = going * 0.05 * np.sin(2 * np.pi * 0.9 * walked + phase[7])
    R = so3_exp(yaw[:, None] * UP) @ so3_exp(pitch[:, None] * np.eye(3)[1]) @ so3_exp(roll[:, None] * np.eye(3)[0])
    return BodyMotion(Trajectory(t, make_pose(R, np.column_stack([xy, z]))))


def drone(seconds: float = 60.0, seed: int = 0) -> BodyMotion:
    """Smooth flight through a room of some metres, always moving."""
    rng = np.random.default_rng(seed)
    t = np.arange(-1.0, seconds + 1.0, 0.05)
    phase, rate = rng.uniform(0, 6, 6), rng.uniform(0.6, 1.1, 6)
    p = np.column_stack([1.5 * np.sin(rate[0] * t + phase[0]), 1.2 * np.sin(rate[1] * t + phase[1]), t * 0])
    p[:, 2] = 1.5 + 0.5 * np.sin(rate[2] * t + phase[2])
    angles = np.column_stack([0.8 * np.sin(rate[3] * t + phase[3]), 0.15 * np.sin(rate[4] * t + phase[4]), t * 0])
    angles[:, 2] = 0.15 * np.sin(rate[5] * t + phase[5])
    R = so3_exp(angles[:, :1] * UP) @ so3_exp(angles[:, 1:2] * np.eye(3)[1]) @ so3_exp(angles[:, 2:] * np.eye(3)[0])
    return BodyMotion(Trajectory(t, make_pose(R, p)))


@dataclass(frozen=True)
class Recording:
    """truth: camera poses (F, 4, 4) in metres at ``times`` (F,). imu: as a data set gives it. offset_s: to be added to
    the samples' times."""

    times: Array
    truth: Array
    imu: Imu
    offset_s: float


def record(
    motion: BodyMotion,
    seconds: float = 60.0,
    *,
    fps: float = 30.0,
    rate_hz: float = 500.0,
    noise: ImuNoise | None = PUBLISHED,
    gyro_bias: tuple[float, float, float] = (0.008, -0.005, 0.012),
    accel_bias: tuple[float, float, float] = (0.06, -0.09, 0.05),
    offset_s: float = 0.0,
    mounting: Array = MOUNTING,
    seed: int = 0,
) -> Recording:
    """Samples of an IMU in ``motion``, from half a second before the first frame to half a second after the last."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 1 / fps)
    t_imu = np.arange(-0.5, seconds + 0.5, 1 / rate_hz)
    gyro, accel = motion.imu(t_imu, UP, GRAVITY)
    gyro, accel = gyro + np.array(gyro_bias), accel + np.array(accel_bias)
    if noise is not None:
        n, step = len(t_imu), 1 / rate_hz
        gyro = gyro + rng.normal(0, noise.gyro / np.sqrt(step), (n, 3))
        accel = accel + rng.normal(0, noise.accel / np.sqrt(step), (n, 3))
        gyro = gyro + np.cumsum(rng.normal(0, noise.gyro_walk * np.sqrt(step), (n, 3)), axis=0)
        accel = accel + np.cumsum(rng.normal(0, noise.accel_walk * np.sqrt(step), (n, 3)), axis=0)
    truth = motion.poses(times) @ mounting
    return Recording(times, truth, Imu(t_imu - offset_s, gyro, accel, mounting, GRAVITY), offset_s)


def seen(
    recording: Recording,
    *,
    scale: float = 0.37,
    noise_m: float = 0.002,
    noise_deg: float = 0.03,
    drift_m: float = 0.002,
    drift_deg: float = 0.01,
    seed: int = 1,
) -> VisualPoses:
    """Poses in axes and unit of a map: white noise, and a drift that is a random walk, per sqrt(s)."""
    rng = np.random.default_rng(seed)
    n, step = len(recording.times), float(np.diff(recording.times)[0])
    world = Sim3(scale, so3_exp(np.array([0.4, 0.9, -0.7])), np.array([1.0, -2.0, 0.5]))
    T = recording.truth.copy()
    wander = np.cumsum(rng.normal(0, drift_m * np.sqrt(step), (n, 3)), axis=0)
    turned = np.cumsum(rng.normal(0, np.radians(drift_deg) * np.sqrt(step), (n, 3)), axis=0)
    T[:, :3, 3] += wander + rng.normal(0, noise_m, (n, 3))
    T[:, :3, :3] = so3_exp(turned) @ T[:, :3, :3] @ so3_exp(rng.normal(0, np.radians(noise_deg), (n, 3)))
    return VisualPoses.of_one_map(recording.times, world.apply_poses(T))


def without(visual: VisualPoses, begin: float, end: float) -> VisualPoses:
    """No poses from ``begin`` to ``end``, s."""
    hidden = (visual.times >= begin) & (visual.times < end)
    return replace(visual, maps=np.where(hidden, -1, visual.maps))


def gravity_error_deg(gravity: Array, recording: Recording, visual: VisualPoses) -> float:
    """Angle between a gravity in the map's axes and the true one there, by the mean of the frames' rotations."""
    known = visual.known
    R = np.einsum("nij,nkj->ik", visual.T_wc[known][:, :3, :3], recording.truth[known][:, :3, :3])
    U, _, Vt = np.linalg.svd(R)
    down = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt @ -UP
    return float(np.degrees(np.arccos(np.clip(gravity @ down / np.linalg.norm(gravity), -1, 1))))

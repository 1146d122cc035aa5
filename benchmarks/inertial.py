"""Recordings with an IMU for reports/inertial.md, in panobench's own format: a walk through a built-in flat.

    python benchmarks/inertial.py OUT [--seconds 60] [--fps 15] [--width 256] [--turns 0] [--black 30:32] ...
    panobench run --method sparse --dataset folder --root OUT --width 256
    panobench run --method sparse --dataset folder --root OUT --width 256 --imu off

A stride is 1.8 a second with 28 mm rms up and down, as measured on the runs of the Hilti x Trimble 360 challenge, and
the IMU has that rig's noise. --turns: glances by 90 degrees and back, at up to 400 degrees/s. --black: no light, s.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.palvio.synth import BodyMotion
from panobench.datasets.writing.writer import write_sequence
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.inertial.samples import ImuNoise
from panobench.rooms import render
from panobench.rooms.motion import closed_spline, rotations
from panobench.rooms.world import World
from panobench.types import Imu, Trajectory

Array = np.ndarray
PUBLISHED = ImuNoise(0.00047032, 0.002859, 0.00036433, 0.0013004)
GRAVITY = 9.80766
MOUNTING = make_pose(so3_exp(np.array([0.3, -1.1, 1.4])), np.array([0.021, 0.014, -0.012]))


def walk(world: World, seconds: float, speed: float, still_s: float, turns: int, gait: float) -> BodyMotion:
    """The camera's motion: rounds of the flat's walk, looking ahead and about."""
    spline, length = closed_spline(world.plan.walk)
    step = 0.01
    t = np.arange(-1.0, seconds + 1.0, step)
    start = np.clip((t - still_s) / 1.0, 0.0, 1.0) if still_s > 0 else np.ones_like(t)
    going = start**2 * (3 - 2 * start)
    walked = np.cumsum(going) * step
    s = speed * (walked + 0.1 * np.sin(0.9 * walked))
    p = spline(s % length)
    ahead = spline((s + 0.3) % length) - p
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + 0.3 * np.sin(0.8 * walked)
    p[:, 2] += gait * 0.0396 * going * np.sin(2 * np.pi * 1.8 * walked)
    side = np.column_stack([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)])
    p += gait * 0.015 * (going * np.sin(2 * np.pi * 0.9 * walked + 1.0))[:, None] * side
    for k in range(turns):  # a raised cosine of the rate: 90 degrees at a peak of 400 degrees/s take 0.45 s
        for begin, sign in ((0.0, 1.0), (1.2, -1.0)):
            u = np.clip((t - (k + 0.6) * seconds / turns - begin) / 0.45, 0.0, 1.0)
            yaw += sign * np.radians(90) * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
    pitch = going * (gait * 0.03 * np.sin(2 * np.pi * 1.8 * walked + 0.7) + 0.1 * np.sin(0.5 * walked))
    roll = going * gait * 0.03 * np.sin(2 * np.pi * 0.9 * walked + 0.2)
    T_wb = make_pose(rotations(yaw, pitch, roll), p) @ invert_pose(MOUNTING)
    return BodyMotion(Trajectory(t, T_wb))


def samples(motion: BodyMotion, seconds: float, rate_hz: float, offset_s: float, seed: int) -> Imu:
    """With white noise, walking biases, and a clock of its own."""
    rng, step = np.random.default_rng(seed), 1 / rate_hz
    t = np.arange(-0.5, seconds + 0.5, step)
    gyro, accel = motion.imu(t, np.array([0.0, 0.0, 1.0]), GRAVITY)
    n = PUBLISHED
    for values, white, drift, bias in (
        (gyro, n.gyro, n.gyro_walk, (0.008, -0.005, 0.012)),
        (accel, n.accel, n.accel_walk, (0.06, -0.09, 0.05)),
    ):
        values += np.array(bias) + rng.normal(0, white / np.sqrt(step), values.shape)
        values += np.cumsum(rng.normal(0, drift * np.sqrt(step), values.shape), axis=0)
    return Imu(t - offset_s + 1.0, gyro, accel, MOUNTING, GRAVITY)


def images(world: World, camera: Camera, T_wc: Array, times: Array, black: tuple[float, float]) -> Iterator[tuple]:
    """(time, RGB, None) frame by frame; times begin at one second."""
    bundle, scene, gain = render.ray_bundle(camera), world.scene, world.path.exposure

    def one(i: int) -> Array:
        if black[0] <= times[i] < black[1]:
            return np.zeros((camera.height, camera.width, 3), np.uint8)
        return render.to_image(render.radiance(scene, bundle, T_wc[i], gain=gain), sigma=0.9 / 255, seed=i)

    with ThreadPoolExecutor(2) as pool:
        for i, image in enumerate(pool.map(one, range(len(times)))):
            yield float(times[i] + 1.0), image, None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--room", default="loop")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--fps", type=float, default=15.0)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--fov", type=float, default=0.0, help="degrees of a pinhole camera; 0: a panorama")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--still", type=float, default=0.0, help="s before the first step")
    parser.add_argument("--turns", type=int, default=0)
    parser.add_argument("--gait", type=float, default=1.0, help="factor on the strides; 0: gliding")
    parser.add_argument("--black", default="0:0")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the IMU, Hz")
    parser.add_argument("--offset", type=float, default=-0.006585, help="s to be added to the IMU's times")
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    world = World(a.room, a.seed, None)
    motion = walk(world, a.seconds, a.speed, a.still, a.turns, a.gait)
    times = np.arange(0.0, a.seconds, 1 / a.fps)
    T_wc = motion.poses(times) @ MOUNTING
    camera: Camera = ErpCamera(a.width, a.width // 2)
    if a.fov:
        f = a.width / 2 / np.tan(np.radians(a.fov) / 2)
        camera = PinholeCamera(a.width, a.width * 3 // 4, f, f, a.width / 2, a.width * 3 / 8)
    black = tuple(float(x) for x in a.black.split(":"))
    write_sequence(
        a.out,
        camera,
        images(world, camera, T_wc, times, black),
        groundtruth=Trajectory(times + 1.0, T_wc),
        imu=samples(motion, a.seconds, a.rate, a.offset, a.seed),
        meta={"made": "benchmarks/inertial.py " + " ".join(f"--{k} {v}" for k, v in vars(a).items() if k != "out")},
    )


if __name__ == "__main__":
    main()

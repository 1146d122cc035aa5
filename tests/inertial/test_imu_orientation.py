"""Integration of angular rates."""

from __future__ import annotations

import numpy as np
from inertial_walks import record, walk

from panobench.geometry import so3_exp
from panobench.inertial.orientation import Orientation, cumulative_product
from panobench.inertial.samples import usable_samples, white_noise


def test_products_are_those_of_one_after_the_other() -> None:
    R = so3_exp(np.random.default_rng(0).normal(size=(23, 3)))
    expected = [R[0]]
    for step in R[1:]:
        expected.append(expected[-1] @ step)
    assert np.allclose(cumulative_product(R), expected)


def test_the_gyroscope_gives_the_turn_between_any_two_times() -> None:
    motion = walk(5.0)
    recording = record(motion, 5.0, rate_hz=1000.0, noise=None, gyro_bias=(0.1, 0, 0), mounting=np.eye(4))
    orientation = Orientation(usable_samples(recording.imu, recording.times), np.array([0.1, 0.0, 0.0]))
    times = np.array([0.1234, 2.7, 4.4321])
    R, T = orientation.at(times), motion.poses(times)[:, :3, :3]
    assert np.allclose(R[0].T @ R[1:], T[0].T @ T[1:], atol=2e-5)


def test_white_noise_is_told_from_motion() -> None:
    rng, step = np.random.default_rng(0), 0.005
    t = np.arange(0, 20, step)[:, None]
    values = 3 * np.sin(2 * np.pi * 1.8 * t * np.ones(3)) + rng.normal(0, 0.02, (len(t), 3))
    assert abs(white_noise(values, step) / (0.02 * np.sqrt(step)) - 1) < 0.1

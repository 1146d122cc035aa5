"""The noise of inertial samples is found under the motion."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.external.imu_noise import sample_noise


@pytest.mark.parametrize("sigma", [0.002, 0.05])
def test_noise_is_found_under_motion_and_impacts(sigma: float) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(4000) / 200.0
    motion = np.stack([2 * np.sin(5 * t), np.cos(3 * t), 0.1 * t], axis=1)
    samples = motion + rng.normal(0, sigma, motion.shape)
    samples[::97] += 3.0  # steps that hit the ground
    assert sample_noise(samples) == pytest.approx(sigma, rel=0.08)


def test_samples_without_noise_have_the_floor() -> None:
    assert sample_noise(np.tile([0.0, 0.0, 9.8], (100, 1)), floor=1e-3) == 1e-3
    assert sample_noise(np.zeros((3, 3)), floor=1e-3) == 1e-3

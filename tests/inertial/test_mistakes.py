"""What is wrong with samples is said, and never becomes a wrong scale."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from inertial_walks import GRAVITY, Recording, drone, record, seen, walk

from panobench.datasets.palvio.synth import BodyMotion
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.inertial.initialise import Initial, initialise
from panobench.inertial.rotation import fit_rotation
from panobench.inertial.samples import InertialError, TooLittleMotionError, usable_samples
from panobench.inertial.visual import VisualPoses
from panobench.types import Imu, Trajectory

SECONDS = 16.0


@lru_cache(maxsize=1)
def recording() -> Recording:
    return record(walk(SECONDS, seed=3), SECONDS, rate_hz=200.0)


def initialised(imu: Imu, visual: VisualPoses | None = None) -> Initial:
    visual = seen(recording()) if visual is None else visual
    samples = usable_samples(imu, visual.times)
    return initialise(visual, samples, fit_rotation(visual, samples))


def test_the_samples_as_they_are_give_the_scale() -> None:
    assert initialised(recording().imu).scale * 0.37 == pytest.approx(1, abs=0.02)


def _rotated(imu: Imu, M: np.ndarray) -> Imu:
    return replace(imu, gyro=imu.gyro @ M.T, accel=imu.accel @ M.T)


MISTAKES: dict[str, tuple[Callable[[Imu], Imu], str]] = {
    "degrees": (lambda i: replace(i, gyro=np.degrees(i.gyro)), "degrees/s"),
    "turns per minute": (lambda i: replace(i, gyro=i.gyro * 30 / np.pi), "9.5[0-9] times too large"),
    "inverse": (lambda i: replace(i, T_body_cam=invert_pose(i.T_body_cam)), "inverse"),
    "exchanged axes": (lambda i: _rotated(i, np.eye(3)[[1, 0, 2]]), "left-handed"),
    "turned axes": (lambda i: _rotated(i, np.eye(3)[[1, 2, 0]]), "axes seem to be"),
    "no mounting": (lambda i: replace(i, T_body_cam=None), "mounting is off by"),
    "gravity's sign": (lambda i: replace(i, accel=-i.accel), "wrong sign"),
    "accelerometer's axes": (lambda i: replace(i, accel=i.accel @ np.eye(3)[[1, 2, 0]]), "contradicts"),
    "accelerometer's gain": (lambda i: replace(i, accel=1.1 * i.accel), "measure (9|10|11)% too much"),
    "without gravity": (
        lambda i: replace(i, accel=i.accel - i.accel.mean(axis=0)),
        "gravity seems to have been taken out",
    ),
    "another unit": (lambda i: replace(i, accel=i.accel * 3.28), "neither 9.8"),
    "another recording": (lambda i: record(drone(SECONDS), SECONDS, rate_hz=200.0).imu, "contradicts"),
    "another clock": (lambda i: replace(i, times=i.times + 1e4), "less than half is covered"),
    "slow": (lambda i: Imu(i.times[::10], i.gyro[::10], i.accel[::10], i.T_body_cam), "samples a second"),
    "cut off": (lambda i: replace(i, accel=np.clip(i.accel, -9.9, 9.9)), "are saturated"),
    "saturated": (lambda i: replace(i, gyro=np.clip(4 * np.sin(i.times)[:, None] + i.gyro, -2, 2)), "are saturated"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_said_in_one_line(mistake: str) -> None:
    change, words = MISTAKES[mistake]
    with pytest.raises(InertialError, match=words) as caught:
        initialised(change(recording().imu))
    assert "\n" not in str(caught.value)
    assert not isinstance(caught.value, TooLittleMotionError)


@pytest.mark.parametrize(("until", "since", "said"), [(4.0, 11.0, "gap"), (11.0, np.inf, "of the time of the frames")])
def test_samples_that_are_missing_contradict_nothing(until: float, since: float, said: str) -> None:
    imu, whole = recording().imu, recording().imu.times
    kept = (whole < whole[0] + until) | (whole > whole[0] + since)
    cut = Imu(imu.times[kept], imu.gyro[kept], imu.accel[kept], imu.T_body_cam)
    visual = seen(recording())
    samples = usable_samples(cut, visual.times)
    assert any(said in remark for remark in samples.remarks)
    found = fit_rotation(visual, samples)
    assert found.offset_s == pytest.approx(fit_rotation(visual, usable_samples(imu)).offset_s, abs=0.002)


def test_levelled_video_is_told_from_the_imu() -> None:
    visual = seen(recording(), noise_deg=0.0, drift_deg=0.0, noise_m=0.0, drift_m=0.0)
    T = recording().truth.copy()  # cameras as they were, but for roll and pitch
    heading = np.arctan2(T[:, 1, 2], T[:, 0, 2])
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T[:, :3, :3] = so3_exp(heading[:, None] * np.array([0.0, 0.0, 1.0])) @ level
    with pytest.raises(InertialError, match="levelled or stabilised"):
        initialised(recording().imu, replace(visual, T_wc=T))


@pytest.mark.parametrize(("unit", "factor"), [("g", 1 / 9.80665), ("milli-g", 1000 / 9.80665), ("cm/s^2", 100.0)])
def test_forces_in_other_units_are_mended_and_said(unit: str, factor: float) -> None:
    imu = replace(recording().imu, accel=recording().imu.accel * factor)
    assert any(f"in {unit}," in remark for remark in usable_samples(imu, recording().times).remarks)
    assert initialised(imu).scale * 0.37 == pytest.approx(1, abs=0.02)


def test_gaps_every_three_seconds_leave_enough_to_tell_the_scale() -> None:
    imu = recording().imu
    kept = imu.times % 3 > 0.3
    cut = replace(imu, times=imu.times[kept], gyro=imu.gyro[kept], accel=imu.accel[kept])
    assert initialised(cut).scale * 0.37 == pytest.approx(1, abs=0.02)


def test_spikes_are_left_out_and_said() -> None:
    imu = recording().imu
    accel = imu.accel.copy()
    accel[50::400] += [150.0, -80.0, 60.0]
    spiky = replace(imu, accel=accel)
    count = len(accel[50::400])
    assert f"{count} samples of the IMU are spikes and left out" in usable_samples(spiky, recording().times).remarks
    assert initialised(spiky).scale * 0.37 == pytest.approx(1, abs=0.02)


def test_the_gyroscopes_gain_is_told() -> None:
    imu, visual = recording().imu, seen(recording())
    samples = usable_samples(replace(imu, gyro=1.04 * imu.gyro), visual.times)
    found = fit_rotation(visual, samples)
    assert 1.01 < found.gain < 1.045
    assert fit_rotation(visual, usable_samples(imu)).gain == pytest.approx(1.0, abs=0.002)


def test_the_sway_of_a_fast_walk_is_not_taken_for_another_unit() -> None:
    """Forces of 1 g that turn twice a second about the vertical: half of the samples are beyond 1.4 g."""
    imu = recording().imu
    phase = 4 * np.pi * imu.times
    force = GRAVITY * np.stack([np.cos(phase), np.zeros_like(phase), 1 + np.sin(phase)], axis=-1)
    assert np.median(np.linalg.norm(force, axis=-1)) > 1.3 * GRAVITY
    samples = usable_samples(replace(imu, accel=force), recording().times)
    assert np.array_equal(samples.accel, force)


def test_a_mounting_that_is_slightly_off_is_corrected_and_said() -> None:
    off = recording().imu.T_body_cam @ make_pose(so3_exp(np.radians([3.0, -2.0, 1.0])), np.zeros(3))
    visual = seen(recording())
    samples = usable_samples(replace(recording().imu, T_body_cam=off), visual.times)
    found = fit_rotation(visual, samples)
    assert re.search(r"off by 3\.[678] degrees", " ".join(found.remarks))
    assert np.allclose(found.R_body_cam, recording().imu.T_body_cam[:3, :3], atol=3e-3)


def test_standing_still_is_too_little_motion() -> None:
    still = record(walk(SECONDS, still_s=100.0), SECONDS, rate_hz=200.0)
    with pytest.raises(TooLittleMotionError, match="turns by"):
        initialised(still.imu, seen(still))


def test_turning_on_the_spot_is_too_little_motion_for_metres() -> None:
    t = np.arange(-1.0, SECONDS + 1.0, 0.05)
    R = so3_exp(np.column_stack([0.3 * np.sin(t), 0.2 * np.sin(1.3 * t), 0.9 * np.sin(0.7 * t)]))
    motion = BodyMotion(Trajectory(t, make_pose(R, np.zeros((len(t), 3)))))
    turning = record(motion, SECONDS, mounting=make_pose(so3_exp([0.3, -1.1, 1.4]), np.zeros(3)))
    with pytest.raises(TooLittleMotionError, match="accelerates too little"):
        initialised(turning.imu, seen(turning, scale=1.0))


def test_gaps_and_repeated_samples_are_said_and_survived() -> None:
    imu = recording().imu
    keep = (imu.times < 6.0) | (imu.times > 6.4)
    order = np.flatnonzero(keep)
    order[100:102] = order[[101, 100]]
    broken = Imu(imu.times[order], imu.gyro[order], imu.accel[order], imu.T_body_cam, GRAVITY)
    samples = usable_samples(broken, recording().times)
    assert any("1 gaps, the longest 0.4" in remark for remark in samples.remarks)
    assert any("sorted" in remark for remark in samples.remarks)
    assert list(samples.covers(np.array([5.9, 7.0]), np.array([6.5, 8.0]))) == [False, True]
    assert initialised(broken).scale * 0.37 == pytest.approx(1, abs=0.02)

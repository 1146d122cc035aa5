"""The next frame's pose, before anything is known, by the gyroscope, and through a blackout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_walks import Recording, record, seen, walk

from panobench.datasets.palvio.synth import BodyMotion
from panobench.geometry import invert_pose, make_pose, so3_exp, so3_log
from panobench.inertial.prediction import Predictor
from panobench.inertial.samples import usable_samples
from panobench.inertial.visual import VisualPoses
from panobench.types import Imu, Trajectory

SCALE = 0.37


def predictor(recording: Recording, visual: VisualPoses) -> Predictor:
    return Predictor(usable_samples(recording.imu), lambda index: visual.T_wc[index])


def test_nothing_is_expected_before_the_camera_has_confirmed_the_gyroscope() -> None:
    recording = record(walk(3.0), 3.0, rate_hz=200.0)
    found = predictor(recording, seen(recording))
    assert found.expect(0.0) is None
    for index in range(20):
        found.record(index, float(recording.times[index]))
    assert found.expect(float(recording.times[20])) is None


def test_the_gyroscope_is_used_as_soon_as_there_are_enough_frames() -> None:
    recording = record(walk(3.0), 3.0, rate_hz=200.0)
    found = predictor(recording, seen(recording))
    frames = np.searchsorted(recording.times, np.arange(0.0, 1.7, 0.125))
    for index in frames[:-1]:
        found.record(int(index), float(recording.times[index]))
    T = found.expect(float(recording.times[frames[-1]]))
    assert T is not None
    assert np.degrees(np.linalg.norm(so3_log(found.pose_of(int(frames[-1]))[:3, :3].T @ T[:3, :3]))) < 0.5


@pytest.mark.parametrize("gap_s", [0.1, 0.5, 2.0])
def test_a_blackout_is_bridged_in_the_maps_unit(gap_s: float) -> None:
    recording = record(walk(22.0, seed=4), 22.0, rate_hz=500.0, offset_s=0.01)
    visual = seen(recording, noise_m=0.001)
    found = predictor(recording, visual)
    last = int(np.searchsorted(recording.times, 18.0))
    for index in range(last + 1):
        found.record(index, float(recording.times[index]))
    then = last + round(gap_s * 30)
    T = found.expect(float(recording.times[then]))
    assert T is not None
    off = invert_pose(visual.T_wc[then]) @ T
    assert np.linalg.norm(off[:3, 3]) / SCALE < 0.005 + 0.015 * gap_s
    assert np.degrees(np.linalg.norm(so3_log(off[:3, :3]))) < 0.3
    assert found.expect(float(recording.times[last]) + 30.0) is None


def test_a_turn_by_400_degrees_a_second_is_expected_though_the_camera_stood_still() -> None:
    t = np.arange(-1.0, 11.0, 0.01)
    yaw = np.radians(np.clip((t - 8.0) * 400, 0, 300)) + 0.3 * np.sin(2 * t) * (t < 7.9)
    R = so3_exp(yaw[:, None] * np.array([0.0, 0.0, 1.0])) @ so3_exp(0.2 * np.sin(t)[:, None] * np.eye(3)[0])
    motion = BodyMotion(Trajectory(t, make_pose(R, np.zeros((len(t), 3)))))
    recording = record(motion, 10.0, rate_hz=500.0)
    visual = seen(recording)
    found = predictor(recording, visual)
    worst, sure = 0.0, 0.0
    for index, time in enumerate(recording.times):
        T = found.expect(float(time))
        if time > 5.0:
            assert T is not None
            off = float(np.linalg.norm(so3_log(visual.T_wc[index][:3, :3].T @ T[:3, :3])))
            worst, sure = max(worst, off), max(sure, found.turn_sigma(float(time)))
        found.record(index, float(time))
    assert np.degrees(worst) < 1.0
    assert worst < 5 * sure < np.radians(3.0)


@pytest.mark.parametrize("lost_s", [1.0, 6.0])
def test_the_way_a_lost_camera_looks_is_known_without_a_scale(lost_s: float) -> None:
    recording = record(walk(22.0, seed=4), 22.0, rate_hz=500.0)
    visual = seen(recording, noise_m=0.001)
    found = predictor(recording, visual)
    last = int(np.searchsorted(recording.times, 8.0))
    for index in range(last + 1):
        found.record(index, float(recording.times[index]))
    found.initial = None
    then = last + round(lost_s * 30)
    time = float(recording.times[then])
    assert found.expect(time) is None
    T = found.heading(time)
    assert T is not None
    off = invert_pose(visual.T_wc[then]) @ T
    assert np.degrees(np.linalg.norm(so3_log(off[:3, :3]))) < 0.5
    assert lost_s > 2 or np.linalg.norm(off[:3, 3]) < 0.5 * SCALE  # a metre of walking
    assert found.heading(float(recording.times[last]) + 30.0) is None


def test_a_gap_of_the_samples_is_no_expectation() -> None:
    recording = record(walk(12.0, seed=4), 12.0, rate_hz=200.0)
    imu = recording.imu
    keep = (imu.times < 10.0) | (imu.times > 10.4)
    imu = Imu(imu.times[keep], imu.gyro[keep], imu.accel[keep], imu.T_body_cam, imu.gravity)
    visual = seen(recording)
    found = Predictor(usable_samples(imu), lambda index: visual.T_wc[index])
    last = int(np.searchsorted(recording.times, 9.9))
    for index in range(last + 1):
        found.record(index, float(recording.times[index]))
    assert found.expect(9.95) is not None
    assert found.expect(10.2) is None


def test_samples_of_another_clock_are_no_expectation_and_no_crash() -> None:
    recording = record(walk(3.0), 3.0, rate_hz=200.0)
    late = replace(recording.imu, times=recording.imu.times + 100.0)
    found = Predictor(usable_samples(late), lambda index: recording.truth[index])
    for index, time in enumerate(recording.times):
        found.record(index, float(time))
        assert found.expect(float(time) + 0.03) is None

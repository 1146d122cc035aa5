"""What methods see of the inertial part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_walks import record, seen, walk

from panobench.inertial.fusion import Unit
from panobench.inertial.stage import InertialStage, MetricPoses
from panobench.types import Imu


def stage(imu: Imu | None, said: list[str]) -> InertialStage:
    return InertialStage(imu, said.append, said.append, lambda index: None)


def test_without_an_imu_nothing_happens() -> None:
    said: list[str] = []
    nothing = stage(None, said)
    nothing.saw(0, 0.0)
    nothing.tracked(0, 0.0)
    assert nothing.expect(0.1) is None
    assert nothing.finish([{0: np.eye(4)}]) is None
    assert (nothing.enabled, said, nothing.times, nothing.numbers) == (False, [], {}, {})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda imu: replace(imu, accel=-imu.accel), "wrong sign"),
        (lambda imu: replace(imu, gyro=np.degrees(imu.gyro)), "degrees/s"),
        (lambda imu: replace(imu, times=imu.times[:5], gyro=imu.gyro[:5], accel=imu.accel[:5]), "5 usable samples"),
    ],
)
def test_a_contradiction_is_one_line_and_no_metres(change, words: str) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("gtsam")
    recording = record(walk(12.0), 12.0, rate_hz=200.0)
    visual, said = seen(recording), []
    wrong = stage(change(recording.imu), said)
    for index, time in enumerate(recording.times):
        wrong.saw(index, float(time))
    assert wrong.finish([dict(enumerate(visual.T_wc))]) is None
    assert len(said) == 1
    assert words in said[0]
    assert "it is not used" in said[0]
    assert wrong.numbers["initialised"] is False


def test_frames_that_vision_lost_get_a_pose_and_the_others_keep_theirs() -> None:
    pytest.importorskip("gtsam")
    recording = record(walk(12.0), 12.0, rate_hz=200.0)
    visual, said = seen(recording), []
    ready = stage(recording.imu, said)
    for index, time in enumerate(recording.times):
        ready.saw(index + 100, float(time))
    lost = range(150, 165)
    metric = ready.finish([{i + 100: T for i, T in enumerate(visual.T_wc) if i not in lost}])
    assert metric is not None
    assert sorted(metric.poses) == list(range(100, 460))
    assert ready.numbers["bridged_frames"] == 15
    assert metric.scale * 0.37 == pytest.approx(1, abs=0.02)
    assert len(said) == 1
    assert "15 frames without a visual pose bridged" in said[0]


def test_two_scales_are_weighted_by_their_variances_and_a_contradiction_is_said() -> None:
    pytest.importorskip("gtsam")
    recording = record(walk(12.0), 12.0, rate_hz=200.0)
    visual = seen(recording)

    def finished(unit: Unit | None) -> tuple[MetricPoses, dict[str, float], list[str]]:
        said: list[str] = []
        ready = stage(recording.imu, said)
        for index, time in enumerate(recording.times):
            ready.saw(index, float(time))
        metric = ready.finish([dict(enumerate(visual.T_wc))], unit)
        assert metric is not None
        return metric, ready.numbers, said

    alone, numbers, _ = finished(None)
    sigma = numbers["scale_sigma"]
    other = Unit(alone.scale * float(np.exp(sigma)), sigma)
    both, fused, said = finished(other)
    assert both.scale == pytest.approx(alone.scale * np.exp(sigma / 2), rel=1e-9)
    assert fused["scale_sigma"] == pytest.approx(sigma / np.sqrt(2))
    assert fused["scale_by_imu"] == pytest.approx(alone.scale)
    grown = both.poses[50][:3, 3] / alone.poses[50][:3, 3]
    np.testing.assert_allclose(grown, both.scale / alone.scale, rtol=1e-9)
    assert not any("apart" in line for line in said)
    _, _, said = finished(Unit(1.2 * alone.scale, 0.001))
    assert any("tell scales that are" in line for line in said)

"""The Hilti challenge's score."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from panobench.geometry import Sim3, so3_exp
from panobench.metrics.base import MetricInput
from panobench.metrics.challenge import challenge_metrics, score
from panobench.testing import TinySequence
from panobench.types import Estimate, Trajectory


class Recorded(TinySequence):
    dataset = "hilti-360"


def measure(estimate: Trajectory, sequence: TinySequence) -> tuple[dict[str, Any], dict[str, str]]:
    data = MetricInput(sequence, Estimate(estimate), list(range(len(sequence))))
    return dict(challenge_metrics(data)), data.notes


def test_points_of_an_error() -> None:
    assert score(np.zeros(3)) == 100
    assert score(np.array([10.0])) == pytest.approx(1.0, rel=1e-6)
    assert score(np.array([0.0, 10.0])) == pytest.approx(50.5, rel=1e-6)
    assert score(np.array([1.0])) == pytest.approx(63.0957, rel=1e-5)


def test_alignment_is_rigid() -> None:
    sequence = Recorded(n=40)
    truth = sequence.groundtruth
    assert truth is not None
    moved = Sim3(1.0, so3_exp([0.3, -1.0, 0.5]), np.array([3.0, -2.0, 1.0])).apply_poses(truth.T_wc)
    assert measure(Trajectory(truth.times, moved), sequence)[0]["challenge_score"] == pytest.approx(100)
    doubled = Sim3(2.0, np.eye(3), np.zeros(3)).apply_poses(truth.T_wc)
    expected = score(np.linalg.norm(truth.positions - truth.positions.mean(axis=0), axis=1))
    found = measure(Trajectory(truth.times, doubled), sequence)[0]["challenge_score"]
    assert found == pytest.approx(expected, rel=1e-6)
    assert found < 90


def test_too_few_poses_score_nothing() -> None:
    sequence = Recorded(n=200)
    truth = sequence.groundtruth
    assert truth is not None
    assert measure(truth.select(np.arange(198)), sequence)[0]["challenge_score"] == pytest.approx(100)
    values, notes = measure(truth.select(np.arange(197)), sequence)
    assert values["challenge_score"] == 0
    assert "98.5%" in notes["challenge_score"]
    assert measure(truth.select(np.arange(0)), sequence)[0]["challenge_score"] == 0


def test_other_data_have_no_such_score() -> None:
    sequence = TinySequence(n=10)
    truth = sequence.groundtruth
    assert truth is not None
    assert measure(truth, sequence)[0] == {}

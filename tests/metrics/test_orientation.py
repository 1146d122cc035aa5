from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import Sim3, make_pose, matrix_from_quaternion, quaternion_from_matrix, so3_exp
from panobench.metrics.base import MetricInput
from panobench.metrics.trajectory import trajectory_metrics
from panobench.testing import TinySequence
from panobench.types import Estimate, Trajectory


@pytest.fixture
def sequence() -> TinySequence:
    return TinySequence(n=12)


def scored(sequence: TinySequence, R: np.ndarray, noise: float = 0.0) -> tuple[dict, dict]:
    """Metrics and notes of an estimate with the right positions, in a world of its own, and orientations ``R``."""
    truth = sequence.groundtruth
    assert truth is not None
    world = Sim3(0.5, so3_exp([0.3, -0.7, 0.2]), np.array([1.0, 2.0, 3.0]))
    positions = truth.positions + noise * np.random.default_rng(0).normal(size=truth.positions.shape)
    moved = world.apply_poses(make_pose(truth.T_wc[:, :3, :3], positions))
    T = moved.copy()
    T[:, :3, :3] = R(moved[:, :3, :3]) if callable(R) else R
    data = MetricInput(sequence, Estimate(Trajectory(truth.times, T)), frames=list(range(12)))
    return trajectory_metrics(data), data.notes


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ([3, 0, 1, 2], "the file has qw first and was read with qw last"),
        ([1, 2, 3, 0], "the file has qw last and was read with qw first"),
    ],
)
def test_another_quaternion_order_is_called_by_its_name(sequence: TinySequence, wrong: list, words: str) -> None:
    values, notes = scored(sequence, lambda R: matrix_from_quaternion(quaternion_from_matrix(R)[:, wrong]))
    assert values["ate_rmse_m"] < 1e-6
    assert words in notes["ate_rotation_rmse_deg"]


@pytest.mark.parametrize(
    ("axes", "degrees"),
    [(np.diag([1.0, -1.0, -1.0]), "180 degrees"), (np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), "120 degrees"),
     (so3_exp([np.pi / 2, 0, 0]), "90 degrees")],
)  # fmt: skip
def test_other_axes_are_called_by_their_name(sequence: TinySequence, axes: np.ndarray, degrees: str) -> None:
    values, notes = scored(sequence, lambda R: R @ axes)
    assert values["ate_rmse_m"] < 1e-6
    assert f"{degrees} about the camera's axis" in notes["ate_rotation_rmse_deg"]


def test_nothing_is_said_of_right_or_of_merely_bad_orientations(sequence: TinySequence) -> None:
    rng = np.random.default_rng(1)
    for turn in (np.zeros(3), rng.normal(0, 0.1, 3), rng.normal(0, 2, (12, 3))):
        _, notes = scored(sequence, lambda R, turn=turn: R @ so3_exp(turn))
        assert "ate_rotation_rmse_deg" not in notes
    _, notes = scored(sequence, lambda R: R @ np.diag([1.0, -1.0, -1.0]), noise=1.0)  # positions are no good either
    assert "ate_rotation_rmse_deg" not in notes

"""ATE and its kin on trajectories whose error is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from panobench.geometry import Sim3, make_pose, so3_exp, umeyama
from panobench.metrics.alignment import match, world_alignment
from panobench.metrics.base import MetricInput
from panobench.metrics.trajectory import trajectory_metrics
from panobench.testing import TinySequence
from panobench.types import Estimate, Trajectory

MOVE = Sim3(1.7, so3_exp([0.3, -1.0, 0.5]), np.array([3.0, -2.0, 1.0]))


def measure(estimate: Estimate, sequence: Any) -> tuple[dict[str, Any], dict[str, str]]:
    data = MetricInput(sequence, estimate, list(range(len(sequence))))
    return trajectory_metrics(data), data.notes


def truth(n: int = 40) -> tuple[TinySequence, Trajectory]:
    sequence = TinySequence(n=n)
    groundtruth = sequence.groundtruth
    assert groundtruth is not None
    return sequence, groundtruth


def test_a_similar_trajectory_has_no_error() -> None:
    sequence, gt = truth()
    values, _ = measure(Estimate(Trajectory(gt.times, MOVE.apply_poses(gt.T_wc)), keyframes=[0, 10, 20, 30]), sequence)
    assert values["ate_rmse_m"] < 1e-12
    assert values["ate_keyframes_rmse_m"] < 1e-12
    assert values["ate_rotation_rmse_deg"] < 1e-5
    assert values["rpe_trans_rmse_m"] < 1e-12
    assert values["scale"] == pytest.approx(1 / 1.7)
    assert values["path_length_m"] == pytest.approx(gt.path_length())


def test_metric_methods_get_their_rigid_error_beside_the_common_one() -> None:
    sequence, gt = truth()
    bigger = Sim3(1.1, np.eye(3), np.zeros(3)).apply_poses(gt.T_wc)
    metric, _ = measure(Estimate(Trajectory(gt.times, bigger), metric=True), sequence)
    free, _ = measure(Estimate(Trajectory(gt.times, bigger)), sequence)
    centred = gt.positions - gt.positions.mean(axis=0)
    # Umeyama without scale can only centre (the rotation stays the identity): the error is 0.1 of the spread
    assert metric["ate_rmse_m"] < 1e-9
    assert metric["scale"] == pytest.approx(1 / 1.1)
    assert metric["scale_error_percent"] == pytest.approx(10)
    assert "scale_error_percent" not in free
    assert metric["ate_se3_rmse_m"] == pytest.approx(0.1 * np.sqrt((centred**2).sum(axis=1).mean()), rel=1e-6)
    assert free["ate_rmse_m"] < 1e-12


def test_the_error_of_gravity() -> None:
    sequence, gt = truth()  # whose world has y down
    levelled = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) @ gt.T_wc[:, :3, :3]
    tilted = so3_exp(np.deg2rad([1.5, -2.0, 0.0])) @ levelled
    for R, error in ((levelled, 0.0), (tilted, 2.5)):
        poses = make_pose(R, gt.positions @ (R[0] @ gt.T_wc[0, :3, :3].T).T)
        values, _ = measure(Estimate(Trajectory(gt.times, poses), gravity_aligned=True), sequence)
        assert values["gravity_error_deg"] == pytest.approx(error, abs=1e-6)
    values, _ = measure(Estimate(gt), sequence)
    assert "gravity_error_deg" not in values


def test_gravity_is_not_judged_where_up_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TinySequence, "world_up", None)
    sequence, gt = truth()
    values, notes = measure(Estimate(gt, gravity_aligned=True), sequence)
    assert values["gravity_error_deg"] is None
    assert "which way is up" in notes["gravity_error_deg"]


def test_evo_agrees_with_our_own_umeyama_under_noise() -> None:
    sequence, gt = truth()
    rng = np.random.default_rng(1)
    noisy = MOVE.apply_poses(gt.T_wc)
    noisy[:, :3, 3] += 0.01 * rng.standard_normal((len(gt), 3))
    moved = umeyama(noisy[:, :3, 3], gt.positions).apply_points(noisy[:, :3, 3])
    values, _ = measure(Estimate(Trajectory(gt.times, noisy)), sequence)
    assert values["ate_rmse_m"] == pytest.approx(np.sqrt(((moved - gt.positions) ** 2).sum(axis=1).mean()), rel=1e-9)


def test_only_frames_with_both_poses_are_compared() -> None:
    sequence, gt = truth()
    poses = gt.T_wc[::3].copy()
    values, _ = measure(Estimate(Trajectory(gt.times[::3], poses), keyframes=[1, 3, 6, 9, 12]), sequence)
    assert values["ate_rmse_m"] < 1e-12
    assert values["ate_keyframes_rmse_m"] < 1e-12  # frame 1 has no pose and is left out


def test_a_straight_path_is_aligned() -> None:
    sequence = TinySequence(n=20, pose=lambda t: make_pose(np.eye(3), [t, 0.0, 0.0]))
    gt = sequence.groundtruth
    assert gt is not None
    values, _ = measure(Estimate(Trajectory(gt.times, MOVE.apply_poses(gt.T_wc))), sequence)
    assert values["ate_rmse_m"] < 1e-9
    matched = match(Trajectory(gt.times, MOVE.apply_poses(gt.T_wc)), gt)
    assert matched is not None
    back = world_alignment(matched)
    assert back.apply_poses(MOVE.apply_poses(gt.T_wc)) == pytest.approx(gt.T_wc, abs=1e-9)


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_poses_give_a_note_not_a_number(n: int) -> None:
    sequence, gt = truth(n)
    values, notes = measure(Estimate(gt), sequence)
    assert values.get("ate_rmse_m") is None
    assert "fewer than three" in notes["ate_rmse_m"]


def test_a_camera_that_only_turns_has_no_ate() -> None:
    from panobench.testing import rotating_pose

    sequence = TinySequence(n=10, pose=rotating_pose)
    gt = sequence.groundtruth
    assert gt is not None
    values, notes = measure(Estimate(gt), sequence)
    assert values.get("ate_rmse_m") is None
    assert "does not move" in notes["ate_rmse_m"]


def test_no_truth_and_nothing_tracked_are_notes() -> None:
    sequence, _ = truth(5)
    values, notes = measure(Estimate(Trajectory(np.zeros(0), np.zeros((0, 4, 4)))), sequence)
    assert values == {}
    assert notes["ate_rmse_m"] == "no tracked frame"


def test_world_alignment_inverts_a_similarity() -> None:
    _, gt = truth()
    matched = match(Trajectory(gt.times, MOVE.apply_poses(gt.T_wc)), gt)
    assert matched is not None
    found = world_alignment(matched)
    assert found.scale == pytest.approx(1 / 1.7)
    assert found.inverse().apply_poses(gt.T_wc) == pytest.approx(matched.estimate.T_wc, abs=1e-9)


class SomeTruth(TinySequence):
    """Truth for some of its frames."""

    def __init__(self, n: int, frames: list[int]) -> None:
        super().__init__(n=n)
        self._frames = frames

    @property
    def groundtruth(self) -> Trajectory | None:
        whole = super().groundtruth
        return None if whole is None else whole.select(self._frames)


def test_rpe_is_over_frames_that_follow_each_other() -> None:
    """A step of 0.1 m at each fifth frame counts where both its frames have truth and a pose, and nowhere else."""
    _, gt = truth()
    moved = gt.T_wc.copy()
    moved[:, 0, 3] += 0.1 * (np.arange(40) // 5)
    whole, _ = measure(Estimate(Trajectory(gt.times, moved)), SomeTruth(40, list(range(40))))
    scale = whole["scale"]
    # in the frame before, the step is of known length: seven steps among 39 pairs, a little more by scale
    assert whole["rpe_trans_rmse_m"] == pytest.approx(0.1 * np.sqrt(7 / 39) * scale, rel=0.3)
    within = [i for i in range(40) if i % 5 not in (0,)]
    values, _ = measure(Estimate(Trajectory(gt.times, moved)), SomeTruth(40, within))
    assert values["rpe_trans_rmse_m"] < 0.3 * whole["rpe_trans_rmse_m"]
    tracked = Trajectory(gt.times[within], moved[within])
    lost, _ = measure(Estimate(tracked), SomeTruth(40, list(range(40))))
    assert lost["rpe_trans_rmse_m"] == pytest.approx(values["rpe_trans_rmse_m"], rel=1e-6)
    apart, notes = measure(Estimate(Trajectory(gt.times, moved)), SomeTruth(40, list(range(0, 40, 2))))
    assert apart["ate_rmse_m"] is not None
    assert apart["rpe_trans_rmse_m"] is None
    assert "no two consecutive frames" in notes["rpe_trans_rmse_m"]

"""A first depth whose own check fails, and what a second method's poses say of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth import bootstrap_check
from panobench.depth.bootstrap import BootstrapDepth
from panobench.depth.bootstrap_check import SolutionCheck, compare_poses
from panobench.depth.bootstrap_starts import TrackStart
from panobench.geometry import make_pose, so3_exp
from panobench.types import DepthEstimate

Poses = dict[int, NDArray[np.float64]]


def walk(n: int = 12, seed: int = 0) -> Poses:
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.normal([0.1, 0.0, 0.02], 0.02, (n, 3)), axis=0)
    return {k: make_pose(so3_exp(rng.normal(0, 0.1, 3)), steps[k]) for k in range(n)}


def test_a_world_s_turn_place_and_scale_do_not_matter() -> None:
    poses = walk()
    world = make_pose(so3_exp([0.3, -1.0, 0.2]), [4.0, 5.0, 6.0])
    moved = {}
    for k, T in poses.items():
        moved[k] = world @ T
        moved[k][:3, 3] = 2.5 * (world[:3, :3] @ T[:3, 3]) + world[:3, 3]
    found = compare_poses(poses, moved)
    assert found.distance < 1e-9
    assert found.angle < 1e-7
    assert found.confirms


def test_other_positions_or_rotations_or_too_few_frames_do_not_confirm() -> None:
    poses, rng = walk(), np.random.default_rng(1)
    spread = np.sqrt(np.var([T[:3, 3] for T in poses.values()], axis=0).sum())
    shaken = {k: make_pose(T[:3, :3], T[:3, 3] + rng.normal(0, 0.1 * spread, 3)) for k, T in poses.items()}
    turned = {k: make_pose(T[:3, :3] @ so3_exp(rng.normal(0, 0.02, 3)), T[:3, 3]) for k, T in poses.items()}
    assert not compare_poses(poses, shaken).confirms
    assert not compare_poses(poses, turned).confirms
    assert not compare_poses(poses, {k: poses[k] for k in range(5)}).confirms
    assert not compare_poses(poses, {}).confirms


def test_standing_still_confirms_nothing() -> None:
    still = {k: np.eye(4) for k in range(12)}
    assert not compare_poses(still, still).confirms
    assert not compare_poses(walk(), still).confirms


@pytest.mark.parametrize(
    ("agreement", "unexplained", "confirmable"), [(0.7, 0.3, True), (0.4, 0.3, False), (0.7, 0.9, False)]
)
def test_only_a_low_agreement_can_be_made_up_for(agreement: float, unexplained: float, confirmable: bool) -> None:
    check = SolutionCheck(unexplained, agreement, spread=2.0, pegged=0.0)
    assert check.problem() is not None
    assert check.confirmable is confirmable


def first_depth() -> DepthEstimate:
    sequence = RoomsDataset().open("tiny", width=128)
    estimator = BootstrapDepth()
    estimator.start(sequence.camera)
    for frame in sequence.frames():
        estimate = estimator.add(frame)
        if estimate is not None:
            return estimate
    estimate = estimator.finish()
    assert estimate is not None
    return estimate


@pytest.mark.slow
def test_feature_tracks_confirm_a_right_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap_check, "AGREEMENT_MIN", 1.0)  # more than a share can be
    estimate = first_depth()
    assert estimate.ok
    assert "feature tracks find the same poses" in estimate.message


@pytest.mark.slow
def test_a_solution_that_feature_tracks_contradict_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap_check, "AGREEMENT_MIN", 1.0)  # more than a share can be
    monkeypatch.setattr(TrackStart, "poses", lambda self: walk(40))
    estimate = first_depth()
    assert not estimate.ok
    assert "apart over" in estimate.message

"""The owner of poses: what a correction moves, and what follows it."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import invert_pose, se3_exp, se3_log
from panobench.methods.panogs.trajectory import (
    AnchoredTrajectory,
    Correction,
    WorldMotion,
    keyframe_motion,
    propagate,
)
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.views import View
from panobench.splat.gaussians import GaussianMap

EMPTY = np.zeros((1, 1, 3), np.uint8)
TURN = se3_exp([0.01, -0.02, 0.03, 0.02, 0.01, 0.0])


def pose(index: int) -> np.ndarray:
    return se3_exp([0.1 * index, 0, 0, 0, 0.1 * index, 0])


class Follower:
    """Remembers the motions it was told of."""

    def __init__(self) -> None:
        self.motions: list[WorldMotion] = []

    def world_moved(self, motion: WorldMotion) -> None:
        self.motions.append(motion)


def tracked() -> tuple[AnchoredTrajectory, Follower]:
    """Frames 0 to 7; 0 and 4 are keyframes, and frame 6 is a view the map is fitted to."""
    trajectory, follower = AnchoredTrajectory(), Follower()
    trajectory.followers = [follower]
    trajectory.add_keyframe(View(0, EMPTY, pose(0)), 0.0)
    for i in range(1, 8):
        trajectory.add(i, i / 15, pose(i), trajectory.keyframes[-1])
        if i == 4:
            trajectory.add_keyframe(View(i, EMPTY, pose(i)))
    trajectory.frames.append(View(6, EMPTY, pose(6)))
    return trajectory, follower


def test_frames_follow_the_refinement_of_their_keyframe() -> None:
    trajectory, _ = tracked()
    trajectory.keyframes[1].T_wc = TURN @ trajectory.keyframes[1].T_wc
    for i in range(8):
        np.testing.assert_allclose(trajectory[i], (TURN if i >= 4 else np.eye(4)) @ pose(i), atol=1e-12)


def test_a_correction_of_poses_moves_them_and_nothing_else() -> None:
    trajectory, follower = tracked()
    trajectory.correct(Correction({3: TURN @ pose(3), 4: TURN @ pose(4), 6: TURN @ pose(6)}))
    for i in range(8):
        moved = i in (3, 4, 5, 6, 7)  # 5 and 7 are anchored to 4
        np.testing.assert_allclose(trajectory[i], (TURN if moved else np.eye(4)) @ pose(i), atol=1e-12)
    np.testing.assert_allclose(trajectory.frames[0].T_wc, TURN @ pose(6), atol=1e-12)
    assert follower.motions == []


def test_a_correction_of_the_world_takes_along_what_follows() -> None:
    trajectory, follower = tracked()
    trajectory.correct(Correction({2: pose(2), 4: TURN @ pose(4)}, True, {4: 1.1}))
    for i in range(8):
        np.testing.assert_allclose(trajectory[i], (TURN if i >= 4 else np.eye(4)) @ pose(i), atol=1e-12)
    (motion,) = follower.motions
    np.testing.assert_allclose(motion.newest, TURN, atol=1e-12)
    assert [m.scale for m in motion.keyframes] == [1.0, 1.1]
    np.testing.assert_allclose(motion.keyframes[1].apply_poses(pose(4)), TURN @ pose(4), atol=1e-12)


def test_no_poses_is_no_correction() -> None:
    trajectory, follower = tracked()
    trajectory.correct(Correction({}, moves_world=True))
    assert follower.motions == []


def test_relative_poses() -> None:
    trajectory, _ = tracked()
    expected = np.stack([invert_pose(pose(i)) @ pose(2) for i in (1, 5)])
    np.testing.assert_allclose(trajectory.relative(2, [1, 5]), expected, atol=1e-12)


def test_a_frame_can_be_taken_out_and_put_back() -> None:
    trajectory, _ = tracked()
    frame = trajectory.pop(3)
    assert frame is not None
    assert trajectory.get(3) is None
    assert trajectory.pop(3) is None
    trajectory.restore(3, frame)
    np.testing.assert_allclose(trajectory[3], pose(3), atol=1e-12)
    assert len(trajectory) == 8


def test_frames_between_corrected_ones_keep_their_place() -> None:
    before = {i: pose(i) for i in range(6)}
    after, newest = propagate(before, {1: before[1], 3: TURN @ before[3]})
    for i in range(6):
        np.testing.assert_allclose(after[i], (TURN if i >= 3 else np.eye(4)) @ before[i], atol=1e-12)
    np.testing.assert_allclose(newest, TURN, atol=1e-12)


@pytest.mark.parametrize("stretch", [1.0, 1.03])
def test_gaussians_look_the_same_from_the_keyframe_that_moved(stretch: float) -> None:
    before, after = se3_exp([1.0, 2.0, 3.0, 0.3, 0.2, 0.1]), se3_exp([1.1, 2.0, 2.9, 0.25, 0.2, 0.15])
    local = np.random.default_rng(1).normal(size=(5, 3))
    world = local @ before[:3, :3].T + before[:3, 3]
    trainable = TrainableMap()
    trainable.append(
        GaussianMap(world, np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1)), np.zeros(5), np.zeros((5, 3))), 0
    )
    trainable.follow([keyframe_motion(before, after, stretch)])
    moved = (trainable.gaussians.means - after[:3, 3]) @ after[:3, :3]
    np.testing.assert_allclose(moved, stretch * local, atol=1e-5)
    assert np.allclose(trainable.gaussians.log_scales, np.log(stretch), atol=1e-6)
    assert np.abs(se3_log(before @ invert_pose(after))).max() > 0.01

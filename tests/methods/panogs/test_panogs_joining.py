"""How one map lies in another, and making them one."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.depth.bootstrap import BootstrapDepth
from panobench.geometry import Sim3, invert_pose, make_pose, so3_exp
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import AtlasOptions
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.several_maps.joining import join, similarity
from panobench.testing import TinySequence, erp_camera
from panobench.types import Frame
from tests.methods.panogs.panogs_options import configured

OPTIONS = AtlasOptions()
MOTION = Sim3(1.7, so3_exp([0.3, -1.2, 0.4]), np.array([1.0, -2.0, 0.5]))
Poses = dict[int, np.ndarray]


def walk(count: int, step: float = 0.05) -> Poses:
    """Straight on, nodding a little."""
    return {i: make_pose(so3_exp([0.05 * np.sin(i), 0.02 * i, 0.0]), [0.0, 0.0, step * i]) for i in range(count)}


def moved(poses: Poses) -> Poses:
    """The same in the other world."""
    back = MOTION.inverse()
    return {i: back.apply_poses(T) for i, T in poses.items()}


def test_frames_that_both_maps_know_tell_how_one_lies_in_the_other() -> None:
    ours = walk(10)
    found = similarity(ours, moved(ours) | {99: np.eye(4)}, 1.0, OPTIONS)
    assert found is not None
    assert found.scale == pytest.approx(MOTION.scale)
    np.testing.assert_allclose(found.R, MOTION.R, atol=1e-9)
    np.testing.assert_allclose(found.t, MOTION.t, atol=1e-9)


def test_a_camera_that_was_wrong_before_it_was_lost_does_not_keep_maps_apart() -> None:
    truth = walk(16)
    ours = {i: T.copy() for i, T in truth.items()}
    for i in range(12, 16):
        ours[i][:3, 3] += 0.2 * (i - 11)
    found = similarity(ours, moved(truth), 1.0, OPTIONS)
    assert found is not None
    assert found.scale == pytest.approx(MOTION.scale, rel=0.02)


@pytest.mark.parametrize("fault", ["few", "still", "turned", "another way", "mirrored"])
def test_frames_that_do_not_tell_or_contradict_one_another_join_nothing(fault: str) -> None:
    ours = walk(7 if fault == "few" else 10, 0.001 if fault == "still" else 0.05)
    theirs = moved(ours)
    if fault == "turned":
        ours = {i: make_pose(T[:3, :3] @ so3_exp([0.0, 0.02 * i, 0.0]), T[:3, 3]) for i, T in ours.items()}
    if fault == "another way":
        ours = {i: make_pose(T[:3, :3], [0.05 * i, 0.0, 0.1 * np.sin(i)]) for i, T in ours.items()}
    if fault == "mirrored":
        ours = {i: make_pose(T[:3, :3], -T[:3, 3]) for i, T in ours.items()}
    assert similarity(ours, theirs, 1.0, OPTIONS) is None


@pytest.mark.slow
def test_two_maps_of_one_room_become_one_that_goes_on() -> None:
    camera = erp_camera(96)
    sequence = TinySequence(camera, 40)
    older, newer = (PanogsMethod(configured(mapping__iterations=3, start__iterations=10)) for _ in range(2))
    for method, frames in ((older, range(20)), (newer, range(8, 32))):
        method.start(camera, MethodContext(make_depth=BootstrapDepth))
        for i in frames:
            method.track(Frame(i, i / 10, sequence.image(i)))
    both = [i for i in older.trajectory if i in newer.trajectory]
    motion = similarity(
        {i: older.trajectory[i] for i in both},
        {i: newer.trajectory[i] for i in both},
        older.mapper.scene_depth,
        AtlasOptions(residual=0.12, moved=0.05),
    )
    assert motion is not None
    height = newer.numbers[25]["height"]
    join(older, newer, motion)
    assert older.numbers[25]["height"] == pytest.approx(motion.scale * height)
    trained = [id(view) for view in (*older.trajectory.frames, *older.mapper.window)]
    assert {id(view) for view in older.trajectory.keyframes} <= set(trained)
    for i in range(32, 40):
        assert older.track(Frame(i, i / 10, sequence.image(i))) is not None
    estimate = older.finish()
    truth = np.stack([sequence.pose_at(t) for t in estimate.trajectory.times])
    assert len(truth) == 40
    path = invert_pose(truth[0]) @ truth
    found = invert_pose(estimate.trajectory.T_wc[0]) @ estimate.trajectory.T_wc
    scale = (found[:, :3, 3] * path[:, :3, 3]).sum() / (found[:, :3, 3] ** 2).sum()
    assert np.abs(scale * found[:, :3, 3] - path[:, :3, 3]).max() < 0.06
    numbers = [view.index for view in older.trajectory.keyframes]
    assert len(numbers) == len(set(numbers)) == older.places.count
    assert older.mapper.map.anchors.max() < len(numbers)

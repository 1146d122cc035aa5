"""Something that crosses the view enters neither the map nor, where a mask hides it, anything else."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from panogs_options import configured

from panobench.datasets.synthetic.disturb import Disturbances, Disturber
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth.simple import OracleDepth
from panobench.geometry import make_pose
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.frame_votes import FrameVotes
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.testing.sequences import erp_camera
from panobench.types import Frame

WIDTH, FRAMES = 128, 40


def mapped(config: PanogsConfig, *, moving: bool = True, masked: bool = False) -> tuple[PanogsMethod, float]:
    """The method after a walk through `tiny` while a disc goes round it, and the PSNR of its map without the disc."""
    sequence = RoomsDataset().open("tiny", width=WIDTH)
    disturb = Disturber(Disturbances(occluder=0.1), sequence.camera, FRAMES)
    method = PanogsMethod(config)
    method.start(sequence.camera, MethodContext(seed=0, make_depth=OracleDepth))
    poses = []
    for i in range(FRAMES):
        clean = sequence.image(i)
        image = disturb(clean, 2 * i) if moving and i else clean
        mask = (image == clean).all(axis=2) if masked else None
        truth = sequence.depth(i) if i == 0 else None
        poses.append(method.track(Frame(i, float(sequence.times[i]), image, depth=truth, mask=mask)))
    estimate = method.finish()
    errors = []
    for i in range(4, FRAMES, 5):
        image = method.render(sequence.camera, estimate.trajectory.T_wc[i])
        assert image is not None
        errors.append(np.mean((image - sequence.image(i) / 255.0) ** 2))
    return method, float(-10 * np.log10(np.mean(errors)))


@pytest.mark.slow
def test_what_crosses_the_view_stays_out_of_the_map() -> None:
    method, psnr = mapped(PanogsConfig())
    _, mapped_too = mapped(configured(moving__enabled=False))
    assert method.mapper.transients.active
    assert psnr > mapped_too + 3.0


@pytest.mark.slow
def test_what_a_frames_mask_hides_stays_out_of_the_map() -> None:
    _, hidden = mapped(configured(moving__enabled=False), masked=True)
    _, without = mapped(PanogsConfig(), moving=False)
    assert hidden > without - 1.5


@pytest.mark.slow
def test_nothing_changes_where_nothing_moves() -> None:
    method, _ = mapped(PanogsConfig(), moving=False)
    other, _ = mapped(configured(moving__enabled=False), moving=False)
    assert not method.mapper.transients.active
    assert method.mapper.map.gaussians.means.tobytes() == other.mapper.map.gaussians.means.tobytes()


def test_the_frames_vote_for_the_scene_and_not_for_what_one_of_them_shows() -> None:
    sequence = RoomsDataset().open("tiny", width=WIDTH)
    truth = sequence.groundtruth
    assert truth is not None
    trajectory = AnchoredTrajectory()
    first = View(0, sequence.image(0), truth.T_wc[0])
    trajectory.add_keyframe(first, 0.0)
    votes = FrameVotes(sequence.camera, trajectory)
    for i in range(12):
        trajectory.add(i, float(sequence.times[i]), truth.T_wc[i], first)
        votes.add(Frame(i, float(sequence.times[i]), sequence.image(i), mappable=i != 3))
    depth = sequence.depth(5)
    assert depth is not None
    where = np.zeros(votes.scale.valid.shape, bool)
    where[20:44] = True
    seen, depth = votes.soft(sequence.image(5)), votes.small(depth)
    for_scene = votes.count(truth.T_wc[5], where, depth, seen)
    for_other = votes.count(truth.T_wc[5], where, depth, 255 - seen)
    assert np.mean(for_scene >= 8) > 0.8
    assert for_scene.max() == 11
    assert np.mean(for_other > for_scene) < 0.05
    nowhere = votes.count(truth.T_wc[5], where, np.full_like(depth, np.nan), seen)
    assert nowhere.max() == 0


@pytest.mark.parametrize(("step", "told"), [(0.02, True), (0.04, True), (0.06, False), (0.3, False)])
def test_frames_that_passed_by_quickly_cannot_tell_what_moved(step: float, told: bool) -> None:
    """A map whose depth is still wrong looks like something that moved to a camera that is elsewhere already."""
    camera = erp_camera(WIDTH)
    grey, depth = np.full((WIDTH // 2, WIDTH, 3), 100, np.uint8), np.full((WIDTH // 2, WIDTH), 2.0, np.float32)
    trajectory, poses = AnchoredTrajectory(), [make_pose(np.eye(3), [2.0 * step * i, 0.0, 0.0]) for i in range(9)]
    first = View(0, grey, poses[0])
    trajectory.add_keyframe(first, 0.0)
    votes = FrameVotes(camera, trajectory)
    for i, T_wc in enumerate(poses):
        trajectory.add(i, i / 10, T_wc, first)
        votes.add(Frame(i, i / 10, grey))
    render: Any = SimpleNamespace(expected_depth=lambda least: depth, colour=grey / np.float32(255))
    everywhere = np.ones(depth.shape, bool)
    changed = votes.moved(poses[-1], render, grey + np.uint8(100), everywhere)
    assert (changed > 0.9) is told
    assert (changed == 0.0) is not told

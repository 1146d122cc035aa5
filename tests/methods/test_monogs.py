"""``monogs``: the rules one by one, and a slow walk past textured walls."""

import dataclasses

import numpy as np
import pytest
from sparse_scenes import view, walk

from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import invert_pose, make_pose, se3_exp, so3_exp, so3_log, umeyama
from panobench.methods.base import MethodContext
from panobench.methods.monogs.config import PRESETS, MonogsConfig
from panobench.methods.monogs.mapper import MonogsMapper, median_depth
from panobench.methods.monogs.method import MonogsMethod
from panobench.methods.monogs.tracker import bright, edges, track
from panobench.splat.render import Renderer
from panobench.types import Frame

CAMERA = PinholeCamera(96, 72, 80.0, 80.0, 48.0, 36.0)
FAST = MonogsConfig(**{**PRESETS["fast"], "initial_iterations": 450, "mapping_iterations": 40, "update_every": 40})


@pytest.fixture(scope="module")
def images():
    return [view(CAMERA, T) for T in walk(16, 0.01)]


def make_mapper(config=FAST, seed=0):
    return MonogsMapper(CAMERA, Renderer(CAMERA, "pinhole"), config, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def begun(images):
    mapper = make_mapper()
    mapper.begin(mapper.keyframe(0, images[0], np.eye(4), 0.0, 0.0))
    return mapper


def test_the_first_layer_is_two_away_and_noisy(images):
    mapper = make_mapper(dataclasses.replace(FAST, initial_iterations=0))
    mapper.begin(mapper.keyframe(0, images[0], np.eye(4), 0.0, 0.0))
    z = mapper.map.gaussians.means[:, 2]
    assert len(z) == 96 * 72 // 32
    assert np.mean(z) == pytest.approx(2.0, abs=0.1)
    assert np.std(z) == pytest.approx(0.3, abs=0.06)


def test_the_first_view_is_learnt(begun, images):
    shown = begun.trainer.renderer.forward(begun.map.gaussians, np.eye(4)).colour
    assert -10 * np.log10(np.mean((shown - images[0] / 255) ** 2)) > 25


def test_tracking_finds_a_pose_and_an_exposure(begun):
    """Of a frame that is a render of the map, so that the truth is exact."""
    T = make_pose(so3_exp([0.01, 0.02, -0.01]), [0.02, -0.02, 0.03])
    out = begun.trainer.renderer.forward(begun.map.gaussians, T)
    frame = np.clip(out.colour * 0.9 * 255 + 8, 0, 255).astype(np.uint8)
    config = dataclasses.replace(FAST, tracking_iterations=100)
    found = track(config, begun.trainer.renderer, begun.map.gaussians, frame, CAMERA.valid_mask(), np.eye(4))
    off = invert_pose(T) @ found.T_wc
    assert np.linalg.norm(off[:3, 3]) < 0.3 * np.linalg.norm(T[:3, 3])
    assert np.linalg.norm(so3_log(off[:3, :3])) < 0.3 * np.linalg.norm(so3_log(T[:3, :3]))
    assert found.gain < -0.02


def test_masks_leave_out_the_dark_and_the_flat():
    image = np.full((72, 96, 3), 100, np.uint8)
    image[:, 48:] = 200
    image[:8] = 0
    shown = bright(FAST, image, CAMERA.valid_mask())
    assert not shown[:8].any()
    assert shown[8:].all()
    steep = edges(FAST, image, shown)
    assert steep[20, 47:49].all()
    assert not steep[20:, :40].any()


def test_a_keyframe_adds_gaussians_near_the_rendered_depth(images):
    mapper = make_mapper()
    mapper.begin(mapper.keyframe(0, images[0], np.eye(4), 0.0, 0.0))
    T = se3_exp([0.05, 0, 0, 0, 0, 0])
    out = mapper.trainer.renderer.forward(mapper.map.gaussians, T, count_touched=True)
    middle, spread = median_depth(out, CAMERA.valid_mask())
    before = len(mapper.map)
    new = mapper.keyframe(5, images[5], T, 0.0, 0.0)
    new.seen = mapper.seen(out.touched)
    assert mapper.extend(new, out)
    assert new.number == 1
    added = mapper.map.gaussians.means[before:] - T[:3, 3].astype(np.float32)
    assert len(added) == 96 * 72 // 64
    assert abs(np.median(np.linalg.norm(added, axis=1)) - middle) < spread
    assert [k.index for k in mapper.window] == [5, 0]


def test_unconfirmed_gaussians_go_once_the_window_is_full(images):
    mapper = make_mapper(dataclasses.replace(FAST, window=3, initial_iterations=50, prune_seen=1))
    mapper.begin(mapper.keyframe(0, images[0], np.eye(4), 0.0, 0.0))
    for i in (1, 2):
        new = mapper.keyframe(i, images[i], np.eye(4), 0.0, 0.0)
        out = mapper.trainer.renderer.forward(mapper.map.gaussians, np.eye(4), count_touched=True)
        new.seen = mapper.seen(out.touched)
        assert mapper.extend(new, out)
    mapper.map.gaussians.means[:40] = [0, 0, -5]  # behind all keyframes
    count = len(mapper.map)
    mapper._prune_unconfirmed()
    assert not (mapper.map.gaussians.means[:, 2] < -4).any()
    assert 0 < len(mapper.map) <= count - 40


def run(images, config=FAST, seed=0):
    method = MonogsMethod(config)
    method.start(CAMERA, MethodContext(seed=seed))
    live = [method.track(Frame(i, 0.1 * i, image, mappable=i % 4 != 3)) for i, image in enumerate(images)]
    return method, method.finish(), live


def test_a_slow_walk_is_followed(images):
    method, estimate, live = run(images)
    truth = walk(16, 0.01)[:, :3, 3]
    found = estimate.trajectory.positions
    assert len(found) == 16
    S = umeyama(found, truth)
    length = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    assert np.sqrt(np.mean(np.sum((S.apply_points(found) - truth) ** 2, axis=1))) < 0.04 * length
    assert len(estimate.keyframes) >= 2
    assert all(k % 4 != 3 for k in estimate.keyframes)
    np.testing.assert_allclose(live[0], np.eye(4))
    shown = method.render(CAMERA, estimate.trajectory.T_wc[7])
    assert -10 * np.log10(np.mean((shown - images[7] / 255) ** 2)) > 18


def test_same_seed_same_answer(images):
    short = dataclasses.replace(FAST, initial_iterations=40, tracking_iterations=10, mapping_iterations=10)
    a, b = (run(images[:7], short, seed=2)[1] for _ in range(2))
    np.testing.assert_array_equal(a.trajectory.T_wc, b.trajectory.T_wc)
    np.testing.assert_array_equal(a.map.means, b.map.means)


def test_a_jump_starts_a_new_map(images):
    """While the first window fills, a keyframe that shares nothing with the others ends the map."""
    config = dataclasses.replace(FAST, initial_iterations=40, tracking_iterations=1, keyframe_interval=1)
    method = MonogsMethod(config)
    method.start(CAMERA, MethodContext())
    method.track(Frame(0, 0.0, images[0]))
    for i in (1, 2):
        method.T_last = make_pose(so3_exp([0, 1.3 * i, 0]), np.zeros(3))  # as if tracking had found this
        method.track(Frame(i, 0.1 * i, view(CAMERA, method.T_last)))
    assert method.restarts == 1
    assert len(method.mapper.keyframes) == 1
    assert len(method.finish().trajectory) == 3


def test_black_frames_start_nothing():
    method = MonogsMethod()
    method.start(CAMERA, MethodContext())
    assert method.track(Frame(0, 0.0, np.zeros((72, 96, 3), np.uint8))) is None
    assert len(method.finish().trajectory) == 0
    assert method.render(CAMERA, np.eye(4)) is None

"""The shared Gaussian trainer, densification and posed depth sweeps."""

import copy

import numpy as np
import pytest

from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import Sim3, make_pose, so3_exp
from panobench.methods.splatting.densify import SHRINK, fade, grow, logit, prune
from panobench.methods.splatting.sweeping import DepthSweeper
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.trainer import GaussianTrainer, PosedImage
from panobench.splat.adam import LearningRates
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer
from panobench.testing.sequences import TinySequence, erp_camera

RATES = LearningRates(1e-3, 0.02, 0.01, 0.05, 0.02)


def cloud(n=300, seed=0):
    rng = np.random.default_rng(seed)
    rays = rng.normal(size=(n, 3))
    means = rays / np.linalg.norm(rays, axis=1, keepdims=True) * rng.uniform(1.5, 2.5, (n, 1))
    return GaussianMap(
        means, rng.normal(np.log(0.12), 0.2, (n, 3)), rng.normal(size=(n, 4)), rng.normal(1, 0.3, n),
        rng.uniform(size=(n, 3)),
    )  # fmt: skip


@pytest.fixture
def trainer():
    t = GaussianTrainer(Renderer(erp_camera(64), "sphere"), TrainableMap(beta2=0.99))
    t.map.append(cloud(), 0)
    return t


def target(trainer, T=None):
    T = np.eye(4) if T is None else T
    image = np.clip(trainer.renderer.forward(trainer.gaussians, T).colour * 255, 0, 255).astype(np.uint8)
    return PosedImage(0, image, T, pixel_weights(trainer.renderer.camera))


def test_steps_fit_the_image(trainer):
    view = target(trainer)
    trainer.gaussians.colours += np.float32(0.2)
    first = trainer.step([view], RATES)[0].loss
    for _ in range(25):
        last = trainer.step([view], RATES)[0].loss
    assert last < 0.5 * first


def test_several_views_are_summed(trainer):
    a, b = target(trainer), target(trainer, make_pose(so3_exp([0, 0.3, 0]), [0.1, 0, 0]))
    a.image, b.image = 255 - a.image, 255 - b.image
    one = trainer.evaluate(a).gradients.packed + trainer.evaluate(b).gradients.packed
    caught = []
    trainer.map.adam.step = lambda gaussians, packed, *rest: caught.append(packed.copy())
    results = trainer.step([a, b], RATES)
    np.testing.assert_array_equal(caught[0], one)
    assert len(results) == 2
    assert trainer.map.pulls.max() == 2


def test_isotropy_follows_finite_differences(trainer):
    trainer.isotropy = 7.0

    def cost(log_scales):
        s = np.exp(log_scales.astype(np.float64))
        return 7.0 * np.abs(s - s.mean(axis=1, keepdims=True)).mean()

    total = np.zeros((len(trainer.map), 14), np.float32)
    trainer._add_isotropy(total)
    for k, axis in ((0, 0), (5, 1), (9, 2)):
        step = np.zeros_like(trainer.gaussians.log_scales)
        step[k, axis] = 1e-3
        numeric = (cost(trainer.gaussians.log_scales + step) - cost(trainer.gaussians.log_scales - step)) / 2e-3
        assert total[k, 3 + axis] == pytest.approx(numeric, rel=2e-2, abs=1e-7)


def test_pull_is_the_gradient_across_the_image():
    """Against finite differences of the loss by a rotation of the Gaussian about the camera."""
    camera = PinholeCamera(64, 48, 60.0, 60.0, 32.0, 24.0)
    t = GaussianTrainer(Renderer(camera, "pinhole"))
    s = np.log(0.2)
    t.map.append(GaussianMap([[0.1, 0.05, 2.0]], [[s, s, s]], [[1, 0, 0, 0]], [1.0], [[1, 1, 1]]), 0)
    blob = np.zeros((48, 64, 3), np.uint8)
    blob[20:30, 38:48] = 255
    view = PosedImage(0, blob, np.eye(4), pixel_weights(camera))
    t.evaluate(view)
    t.step([view], LearningRates(0.0, 0.0, 0.0, 0.0, 0.0))
    mean = t.gaussians.means.copy()
    slopes = []
    for axis in (0, 1):
        moved = []
        for sign in (1, -1):
            step = np.zeros(3, np.float32)
            step[axis] = sign * 0.01
            t.gaussians.means[:] = mean + step
            moved.append(t.evaluate(view).loss)
        slopes.append((moved[0] - moved[1]) / 0.02)
    # A metre across at distance 2 is 30 pixels; pull counts in half image widths.
    expected = np.hypot(*slopes) / 30 * 32
    assert t.map.pull[0] == pytest.approx(expected, rel=0.1)
    assert t.map.pulls[0] == 1


def test_growing_clones_small_and_splits_large(trainer):
    n = len(trainer.map)
    trainer.map.pulls[:] = 1
    trainer.map.pull[:10] = 1.0
    trainer.gaussians.log_scales[:4] = np.log(0.5)
    trainer.gaussians.log_scales[4:10] = np.log(0.01)
    trainer.map.anchors[:] = np.arange(n)
    assert grow(trainer.map, 0.5, 0.1, np.random.default_rng(0), 10 * n) == 10
    assert len(trainer.map) == n + 10  # four split in two, six doubled
    sizes = trainer.gaussians.log_scales.max(axis=1)
    assert np.count_nonzero(np.isclose(sizes, np.log(0.5 / SHRINK))) == 8
    assert not np.isclose(sizes, np.log(0.5)).any()
    assert np.count_nonzero(np.isin(trainer.map.anchors, range(4))) == 8
    assert np.count_nonzero(np.isin(trainer.map.anchors, range(4, 10))) == 12
    assert trainer.map.pull.max() == 0
    trainer.step([target(trainer)], RATES)  # the optimiser's state grew along


def test_growing_respects_the_limit(trainer):
    trainer.map.pulls[:] = 1
    trainer.map.pull[:] = np.arange(len(trainer.map))
    assert grow(trainer.map, 0.5, 0.1, np.random.default_rng(0), len(trainer.map) + 7) == 7


def test_pruning_and_fading(trainer):
    n = len(trainer.map)
    trainer.gaussians.opacity_logits[:5] = logit(0.01)
    trainer.gaussians.log_scales[5:8] = np.log(9.0)
    trainer.gaussians.means[8] = np.nan
    also = np.zeros(n, bool)
    also[9:11] = True
    assert prune(trainer.map, 0.05, 3.0, also) == 11
    assert len(trainer.map) == len(trainer.map.adam.steps) == len(trainer.map.anchors) == n - 11
    trainer.map.adam.m[:, 10] = 1
    fade(trainer.map, 0.3)
    assert trainer.gaussians.opacity_logits.max() <= np.float32(logit(0.3))
    assert trainer.map.adam.m[:, 10].max() == 0


def test_gaussians_follow_their_camera(trainer):
    before = make_pose(so3_exp([0.1, 0.2, 0]), [0.3, 0, 0.1])
    after = make_pose(so3_exp([0.2, -0.1, 0.1]), [0.1, 0.2, 0.1])
    seen = trainer.renderer.forward(trainer.gaussians, before)
    R = after[:3, :3] @ before[:3, :3].T
    motion = Sim3(2.0, R, after[:3, 3] - 2.0 * R @ before[:3, 3])
    other = copy.deepcopy(trainer.map)
    trainer.map.move(np.ones(len(trainer.map), bool), motion)
    other.follow([motion])
    np.testing.assert_allclose(other.gaussians.means, trainer.gaussians.means, atol=1e-5)
    np.testing.assert_allclose(other.gaussians.log_scales, trainer.gaussians.log_scales, atol=1e-5)
    again = trainer.renderer.forward(trainer.gaussians, after)
    np.testing.assert_allclose(again.planes, seen.planes, atol=5e-3)
    np.testing.assert_allclose(again.depth, 2 * seen.depth, atol=5e-2)


CAMERAS = {
    "erp": lambda: erp_camera(128),
    "pinhole": lambda: PinholeCamera(96, 96, 55.0, 55.0, 48.0, 48.0),
    "fisheye": lambda: KannalaBrandtCamera(96, 96, 40.0, 40.0, 48.0, 48.0),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_swept_depth_is_right(kind):
    sequence = TinySequence(CAMERAS[kind](), 12)
    sweeper = DepthSweeper(sequence.camera, 128, 6)
    for k in range(12):
        sweeper.add(sequence.image(k), sequence.pose_at(sequence.times[k]))
    depth, true = sweeper.depth(3), sequence.depth(3)
    assert depth.shape == true.shape
    known = np.isfinite(depth)
    assert known[sequence.camera.valid_mask()].mean() > 0.8
    assert np.median(np.abs(depth[known] / true[known] - 1)) < 0.04


def test_no_parallax_no_depth():
    sequence = TinySequence(n=3, pose=lambda t: np.eye(4))
    sweeper = DepthSweeper(sequence.camera, 64, 4)
    for k in range(3):
        sweeper.add(sequence.image(k), np.eye(4))
    assert sweeper.depth(0) is None

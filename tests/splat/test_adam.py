"""The optimiser: the fused pass is the two it replaces, and rates reach the parameters they are named after."""

import numpy as np
import pytest
from splat_scenes import CAMERAS, CASES, POSE, random_scene

from panobench.splat.adam import GaussianAdam, LearningRates
from panobench.splat.render import Renderer
from panobench.splat.view import Projection

RATES = LearningRates(1e-3, 0.02, 0.01, 0.05, 0.02, lift=0.2, tilt=0.1)
NONE = LearningRates(0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("camera", "projection"), CASES)
@pytest.mark.parametrize("isotropy", [0.0, 0.01])
def test_backward_and_step_in_one_is_backward_then_step(camera: str, projection: Projection, isotropy: float) -> None:
    start = random_scene(200, 3, camera, projection)
    renderer = Renderer(CAMERAS[camera], projection)
    shape = (3, CAMERAS[camera].height, CAMERAS[camera].width)
    weights = np.random.default_rng(5).normal(size=shape).astype(np.float32)
    apart, fused = start.copy(), start.copy()
    a, b = GaussianAdam(len(start), 0.9, 0.99), GaussianAdam(len(start), 0.9, 0.99)
    for _ in range(3):
        gradients = renderer.forward(apart, POSE).backward(weights, planar=True)
        a.step(apart, gradients.packed, RATES, isotropy)
        pose = b.backward_step(renderer.forward(fused, POSE), weights, RATES, isotropy)
        np.testing.assert_allclose(pose, gradients.pose, rtol=1e-4, atol=1e-4 * np.abs(gradients.pose).max())
    np.testing.assert_array_equal(a.steps, b.steps)
    assert a.steps.max() == 3
    for one, other, first in zip(apart.arrays(), fused.arrays(), start.arrays()):
        assert not np.array_equal(one, first)
        np.testing.assert_allclose(one, other, atol=2e-4)


@pytest.mark.parametrize(
    ("rate", "array"),
    [("position", "means"), ("log_scale", "log_scales"), ("rotation", "quats"), ("opacity", "opacity_logits"),
     ("colour", "colours")],
)  # fmt: skip
def test_each_rate_moves_its_own_parameter_only(rate: str, array: str) -> None:
    start = random_scene(60, 4, "erp")
    start.quats /= np.linalg.norm(start.quats, axis=1, keepdims=True)
    moved, adam = start.copy(), GaussianAdam(len(start))
    g = np.random.default_rng(1).normal(size=(len(start), 14)).astype(np.float32)
    adam.step(moved, g, LearningRates(**{**NONE.__dict__, rate: 0.01}))
    for name in ("means", "log_scales", "quats", "opacity_logits", "colours"):
        change = np.abs(getattr(moved, name) - getattr(start, name)).max()
        assert (change > 1e-3) == (name == array), name


def test_what_has_no_finite_gradient_stays() -> None:
    start = random_scene(4, 4, "erp")
    moved, adam = start.copy(), GaussianAdam(len(start))
    g = np.ones((4, 14), np.float32)
    g[1], g[2, 5], g[3, 0] = 0.0, np.nan, np.inf
    adam.step(moved, g, RATES)
    np.testing.assert_array_equal(adam.steps, [1, 0, 0, 0])
    np.testing.assert_array_equal(moved.means[1:], start.means[1:])

"""Rendering a rig's panorama: each half from its own lens."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig_panorama import RigPanorama
from panobench.geometry import invert_pose, make_pose, se3_exp, so3_exp
from panobench.splat.adam import GaussianAdam, LearningRates
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.splat.rig_render import RigRenderer, renderer_for
from panobench.testing import two_lenses

T_WC = make_pose(so3_exp([0.1, 0.4, -0.05]), [0.1, -0.05, 0.2])


@pytest.fixture(scope="module")
def camera() -> RigPanorama:
    made = RigPanorama.of(two_lenses(72, 0.3), ErpCamera(128, 64))
    assert made.lenses is not None
    made.lenses.units_per_metre = 1.0
    return made


@pytest.fixture
def gaussians() -> GaussianMap:
    rng, n = np.random.default_rng(0), 300
    means = rng.normal(size=(n, 3))
    means *= rng.uniform(1.5, 3.0, (n, 1)) / np.linalg.norm(means, axis=1, keepdims=True)
    quats = rng.normal(size=(n, 4))
    return GaussianMap(
        means.astype(np.float32),
        np.log(rng.uniform(0.1, 0.3, (n, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.normal(size=n).astype(np.float32),
        rng.uniform(0, 1, (n, 3)).astype(np.float32),
    )


def test_each_half_is_what_its_lens_sees(camera: RigPanorama, gaussians: GaussianMap) -> None:
    renderer = renderer_for(camera, "sphere", 0.3)
    assert isinstance(renderer, RigRenderer)
    found, plain = renderer.forward(gaussians, T_WC, count_touched=True, sum_weights=True), Renderer(ErpCamera(128, 64))
    front, back = (plain.forward(gaussians, T_WC @ make_pose(np.eye(3), [0, 0, z])) for z in (0.15, -0.15))
    seen = camera.valid_mask()
    for number, whole in enumerate((front, back)):
        own = seen & (camera.lens == number)
        np.testing.assert_allclose(found.colour[own], whole.colour[own], atol=1e-6)
        np.testing.assert_allclose(found.depth[own], whole.depth[own], atol=1e-5)
    assert found.touched is not None
    assert found.weights is not None
    assert found.weights.sum() == pytest.approx(found.opacity.sum(), rel=0.05)


def test_gradients_are_those_of_the_loss(gaussians: GaussianMap) -> None:
    far_apart = RigPanorama.of(two_lenses(72, 1.2), ErpCamera(128, 64))
    assert far_apart.lenses is not None
    far_apart.lenses.units_per_metre = 1.0
    renderer = RigRenderer(far_apart)
    u, v = np.meshgrid(np.arange(128) / 128, np.arange(64) / 64)
    weight = np.tile(np.cos(4 * np.pi * u) + np.sin(8 * v), (3, 1, 1)) * far_apart.valid_mask()
    weight = weight.astype(np.float32)

    def loss(T_wc: np.ndarray) -> float:
        return float((renderer.forward(gaussians, T_wc).planes.astype(np.float64) * weight).sum())

    found = renderer.forward(gaussians, T_WC).backward(weight, planar=True)
    numeric = np.zeros(6)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-2
        there, back = (invert_pose(se3_exp(s * step) @ invert_pose(T_WC)) for s in (1, -1))
        numeric[k] = (loss(there) - loss(back)) / 2e-2
    np.testing.assert_allclose(found.pose, numeric, atol=0.06 * np.linalg.norm(numeric))
    assert np.abs(found.means).max() > 0


def test_a_step_of_adam_lowers_the_loss(camera: RigPanorama, gaussians: GaussianMap) -> None:
    renderer, adam = RigRenderer(camera), GaussianAdam(len(gaussians))
    wanted = renderer.forward(gaussians, T_WC).planes.copy()
    changed = gaussians.copy()
    changed.colours[:] = 0.5
    losses = []
    for _ in range(4):
        render = renderer.forward(changed, T_WC)
        difference = (render.planes - wanted) * camera.valid_mask()
        losses.append(float((difference**2).sum()))
        adam.backward_step(render, 2 * difference, LearningRates(0.0, 0.0, 0.0, 0.0, 0.05))
    assert losses[-1] < 0.7 * losses[0]


def test_a_detached_render_knows_its_map_no_more(camera: RigPanorama, gaussians: GaussianMap) -> None:
    render = RigRenderer(camera).forward(gaussians, T_WC)
    assert render.gaussians is gaussians
    with pytest.raises(RuntimeError, match="detached"):
        render.detach().backward(np.zeros((3, 64, 128), np.float32), planar=True)

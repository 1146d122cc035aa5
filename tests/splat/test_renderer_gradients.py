"""Analytic gradients of the kernels against the float64 oracle: its autograd and its finite differences."""

from __future__ import annotations

import weakref

import numpy as np
import pytest
import torch
from splat_scenes import CAMERAS, CASES, NAMES, POSE, Reference, gaussian_map, random_scene, reference, render_oracle

from panobench.cameras.base import Camera
from panobench.gpu.device import Device
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Gradients, Renderer
from panobench.splat.view import Projection


def loss_weights(want: Reference, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random dL/d(colour, depth, opacity), zero where rounding decides about the cut."""
    rng = np.random.default_rng(seed)
    shape = want.steady.shape
    keep = want.steady
    return (
        rng.normal(size=(*shape, 3)) * keep[..., None],
        rng.normal(size=shape) * keep,
        rng.normal(size=shape) * keep,
    )


def weigh(out: tuple[torch.Tensor, ...], weights: tuple[np.ndarray, ...]) -> torch.Tensor:
    return sum(((o * torch.tensor(w)).sum() for o, w in zip(out, weights)), torch.zeros((), dtype=torch.float64))


def kernel_gradients(
    g: GaussianMap,
    camera: Camera,
    projection: Projection,
    weights: tuple[np.ndarray, ...],
    T_wc: np.ndarray = POSE,
    device: Device | None = None,
) -> Gradients:
    render = Renderer(camera, projection, stop=0.0, device=device).forward(g, T_wc)
    return render.backward(*(w.astype(np.float32) for w in weights))


def check(
    g: GaussianMap,
    camera: Camera,
    projection: Projection,
    T_wc: np.ndarray = POSE,
    rtol: float = 1e-4,
    device: Device | None = None,
) -> tuple[Gradients, Reference]:
    want = reference(g, camera, T_wc, projection)
    assert want.steady.mean() > 0.9
    weights = loss_weights(want)
    weigh(want.out, weights).backward()
    got = kernel_gradients(g, camera, projection, weights, T_wc, device)
    for name in NAMES:
        a, b = getattr(got, name), want.gradients()[name]
        assert np.abs(b).max() > 0
        error = np.abs(a - b).max() / np.abs(b).max()
        assert error < rtol, f"{name}: {error:.2e} of the largest"
        # Every Gaussian's own gradient, not only the large ones.
        norm = np.linalg.norm(b.reshape(len(b), -1), axis=1)
        each = np.linalg.norm((a - b).reshape(len(b), -1), axis=1)
        worst = (each / (norm + 1e-2 * norm.max())).max()
        assert worst < 20 * rtol, f"{name}: {worst:.2e} of one Gaussian's"
    pose = want.gradients()["pose"]
    np.testing.assert_allclose(got.pose, pose, atol=rtol * np.abs(pose).max())
    return got, want


@pytest.mark.parametrize(("camera", "projection"), CASES)
@pytest.mark.parametrize("seed", [0, 1])
def test_gradients_match_the_oracles_autograd(camera: str, projection: Projection, seed: int) -> None:
    check(random_scene(80, seed, camera, projection), CAMERAS[camera], projection)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_gradients_through_many_layers(camera: str, projection: Projection) -> None:
    check(random_scene(250, 7, camera, projection, logit=2.0), CAMERAS[camera], projection)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_gradients_match_finite_differences_of_the_oracle(camera: str, projection: Projection) -> None:
    """Central differences in float64 for every parameter and the pose; nothing of autograd is in them."""
    cam = CAMERAS[camera].scaled(36)
    g = random_scene(7, 11, camera, projection)
    got, want = check(g, cam, projection)
    weights = loss_weights(want)
    values = [p.detach() for p in want.parameters]

    def loss(parameters: list[torch.Tensor], tau: torch.Tensor) -> float:
        with torch.no_grad():
            return float(weigh(render_oracle(parameters, cam, POSE, tau=tau, projection=projection), weights))

    zero = torch.zeros(6, dtype=torch.float64)
    step = 1e-6
    for index, (name, value) in enumerate(zip(NAMES, values)):
        numeric = np.zeros(value.numel())
        for k in range(value.numel()):
            ends = []
            for sign in (1, -1):
                moved = value.clone()
                moved.view(-1)[k] += sign * step
                ends.append(loss([*values[:index], moved, *values[index + 1 :]], zero))
            numeric[k] = (ends[0] - ends[1]) / (2 * step)
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(want.gradients()[name].ravel(), numeric, atol=1e-6 * scale, err_msg=name)
        np.testing.assert_allclose(getattr(got, name).ravel(), numeric, atol=1e-4 * scale, err_msg=name)
    numeric = np.zeros(6)
    for k in range(6):
        plus, minus = (loss(values, sign * step * torch.eye(6, dtype=torch.float64)[k]) for sign in (1, -1))
        numeric[k] = (plus - minus) / (2 * step)
    scale = np.abs(numeric).max()
    np.testing.assert_allclose(want.gradients()["pose"], numeric, atol=1e-6 * scale)
    np.testing.assert_allclose(got.pose, numeric, atol=1e-4 * scale)


POLES = gaussian_map(
    [[0.02, -2, 0.01], [0.05, 1.5, -0.03], [0.03, 0.4, -2], [-0.1, -0.3, -2.5], [0.0, -3.0, 0.0], [0.4, -1.8, 0.2]],
    scale=[[0.2, 0.1, 0.3], [0.1, 0.25, 0.15], [0.3, 0.1, 0.1], [0.1, 0.2, 0.3], [0.6, 0.3, 0.5], [0.2, 0.1, 0.1]],
    logit=[1.0, 0.5, 2.0, 1.5, 0.0, 1.0],
    colour=np.random.default_rng(0).uniform(size=(6, 3)),
    quats=np.random.default_rng(1).normal(size=(6, 4)),
)


def test_gradients_at_the_seam_and_both_poles() -> None:
    check(POLES, CAMERAS["erp"], "sphere", np.eye(4))


def test_first_order_gradients_at_the_seam() -> None:
    check(POLES.select(np.array([2, 3])), CAMERAS["erp"], "erp", np.eye(4))


def test_gradients_beside_the_pinhole_where_the_jacobian_is_bounded() -> None:
    """Means outside 1.3 half fields of view, footprints large enough to reach into the image."""
    g = gaussian_map(
        [[2.4, 0.1, 2.0], [-2.6, 0.2, 2.2], [0.1, 1.8, 2.0], [0.2, -1.9, 2.1], [2.5, 1.8, 2.0], [0.1, 0.1, 2.0]],
        scale=[0.9, 0.6, 0.7],
        logit=[2.0, 1.0, 1.5, 1.0, 3.0, 0.0],
        colour=np.random.default_rng(2).uniform(size=(6, 3)),
        quats=np.random.default_rng(3).normal(size=(6, 4)),
    )
    got, _ = check(g, CAMERAS["pinhole"], "pinhole", np.eye(4))
    assert (np.abs(got.means[:5]).max(axis=1) > 0).all()
    check(g, CAMERAS["pinhole"], "sphere", np.eye(4))


def test_no_gradient_through_a_saturated_alpha() -> None:
    """sigmoid(30) saturates near the centre: there only what is behind and the colour still learn."""
    camera = CAMERAS["erp"]
    g = gaussian_map([[0, 0, 2.0], [0.02, 0.01, 3.0]], scale=[[5.0] * 3, [0.1] * 3], logit=[30.0, 0.0])
    render = Renderer(camera, stop=0.0).forward(g, np.eye(4))
    d_colour = np.zeros((36, 72, 3), np.float32)
    d_colour[18, 36] = 1.0
    got = render.backward(d_colour)
    for a in (got.means, got.log_scales, got.quats, got.opacity_logits):
        assert not a[0].any()
    np.testing.assert_allclose(got.colours[0], 0.99, rtol=1e-5)
    assert got.means[1].any()
    assert 0 < got.opacity_logits[1] < 0.01


def test_gradients_that_are_not_given_count_as_zero() -> None:
    camera = CAMERAS["erp"]
    g = random_scene(40, 12, "erp")
    out = Renderer(camera).forward(g, POSE)
    d = np.random.default_rng(0).normal(size=out.colour.shape).astype(np.float32)
    zero = np.zeros(out.depth.shape, np.float32)
    alone, padded = out.backward(d), out.backward(d, zero, zero)
    np.testing.assert_array_equal(alone.packed, padded.packed)
    np.testing.assert_array_equal(alone.pose, padded.pose)
    assert alone.packed.any()


def test_gradients_add_up() -> None:
    """Backward is linear in dL/d(output)."""
    camera = CAMERAS["pinhole"]
    out = Renderer(camera).forward(random_scene(40, 13, "pinhole"), POSE)
    rng = np.random.default_rng(0)
    dc, dd, do = (rng.normal(size=a.shape).astype(np.float32) for a in (out.colour, out.depth, out.opacity))
    whole = out.backward(dc, dd, do)
    parts = [out.backward(dc), out.backward(0 * dc, dd), out.backward(0 * dc, None, do)]
    total = sum(p.packed for p in parts)
    np.testing.assert_allclose(whole.packed, total, atol=2e-5 * np.abs(total).max())
    np.testing.assert_allclose(whole.pose, sum(p.pose for p in parts), atol=2e-5 * np.abs(whole.pose).max())


def test_a_render_differentiates_itself_whatever_was_rendered_since() -> None:
    renderer = Renderer(CAMERAS["erp"])
    d = np.random.default_rng(0).normal(size=(36, 72, 3)).astype(np.float32)
    render = renderer.forward(random_scene(40, 12, "erp"), POSE)
    want = render.backward(d)
    renderer.forward(random_scene(30, 13, "erp"), np.eye(4))
    got = render.backward(d)
    np.testing.assert_array_equal(got.packed, want.packed)
    np.testing.assert_array_equal(got.pose, want.pose)
    assert got.packed.shape == (40, 14)


def test_a_detached_render_keeps_its_images_and_lets_go_of_the_map() -> None:
    g = random_scene(40, 12, "erp")
    render = Renderer(CAMERAS["erp"]).forward(g, POSE)
    held = weakref.ref(g)
    kept = render.detach()
    np.testing.assert_array_equal(kept.planes, render.planes)
    del g, render
    assert held() is None
    with pytest.raises(RuntimeError, match="detached"):
        kept.backward(np.zeros((36, 72, 3), np.float32))


def test_weighted_sums_are_the_gradients_by_the_colours() -> None:
    g = random_scene(40, 3, "erp")
    render = Renderer(CAMERAS["erp"]).forward(g, POSE)
    planes = np.random.default_rng(0).normal(size=(3, 36, 72)).astype(np.float32)
    np.testing.assert_allclose(
        render.weighted_sums(planes), render.backward(planes, planar=True).colours, rtol=1e-5, atol=1e-6
    )

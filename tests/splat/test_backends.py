"""Every backend against the float64 oracle, and every device against the Numba kernels."""

from __future__ import annotations

import numpy as np
import pytest
from cuda_devices import DEVICES, open_device
from splat_scenes import CAMERAS, POSE, random_scene, reference
from test_renderer_gradients import POLES, check

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import UnsupportedError
from panobench.gpu.device import Device
from panobench.splat.adam import GaussianAdam, LearningRates, Target
from panobench.splat.backend import device_for, empty_map, new_adam
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer

#: Its size is no multiple of a tile's.
CAMERA = CAMERAS["erp"]
RATES = LearningRates(1e-2, 0.04, 0.06, 0.1, 0.02, lift=0.2, tilt=0.1)


@pytest.fixture(params=["numba", *DEVICES])
def backend(request: pytest.FixtureRequest) -> Device | None:
    return open_device(request.param)


@pytest.fixture(params=list(DEVICES))
def device(request: pytest.FixtureRequest) -> Device:
    return DEVICES[request.param]()


def close(got: np.ndarray, want: np.ndarray, rtol: float) -> None:
    """Equal but for ``rtol`` of the norm."""
    error = np.linalg.norm(np.asarray(got, float) - want) / np.linalg.norm(want)
    assert error < rtol, f"{error:.1e}"


# -- against the oracle ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("logit", [0.5, 3.0])
def test_images_are_the_oracles(backend: Device | None, logit: float) -> None:
    g = random_scene(120, 3, "erp", logit=logit)
    want = reference(g, CAMERA, POSE, "sphere")
    got = Renderer(CAMERA, stop=0.0, device=backend).forward(g, POSE)
    for image, oracle in zip((got.colour, got.depth, got.opacity), want.out):
        np.testing.assert_allclose(image[want.steady], oracle.detach().numpy()[want.steady], atol=2e-4)


@pytest.mark.parametrize("seed", [0, 1])
def test_gradients_are_the_oracles(backend: Device | None, seed: int) -> None:
    check(random_scene(80, seed, "erp"), CAMERA, "sphere", device=backend)


def test_gradients_are_the_oracles_at_the_seam_and_both_poles(backend: Device | None) -> None:
    check(POLES, CAMERA, "sphere", np.eye(4), device=backend)


# -- against the Numba kernels -----------------------------------------------------------------------------------------


def test_what_a_render_measures_is_numbas(device: Device) -> None:
    g = random_scene(200, 5, "erp", logit=1.0)
    options = {"count_touched": True, "sloped": True, "sum_weights": True}
    want = Renderer(CAMERA).forward(g, POSE, **options)
    got = Renderer(CAMERA, device=device).forward(g, POSE, **options)
    np.testing.assert_array_equal(got.order, want.order)
    assert got.drawn == want.drawn == len(want.order)
    assert want.touched is not None
    assert got.touched is not None
    # A pixel at the edge of a footprint may fall on the other side.
    assert np.abs(got.touched - want.touched).max() <= 1
    assert np.count_nonzero(got.touched != want.touched) < 4
    close(got.weights, want.weights, 1e-4)
    close(got.depth, want.depth, 1e-4)
    flat = Renderer(CAMERA, device=device).forward(g, POSE)
    assert np.abs(flat.depth - got.depth).max() > 1e-3
    with pytest.raises(ValueError, match="sloped"):
        got.backward(got.colour, got.depth)


def test_what_is_culled_is_not_drawn(device: Device) -> None:
    g = random_scene(100, 6, "erp")
    culled = np.random.default_rng(0).random(100) < 0.5
    got = Renderer(CAMERA, device=device).forward(g, POSE, culled=culled)
    want = Renderer(CAMERA).forward(g, POSE, culled=culled)
    assert got.drawn == want.drawn < 100
    close(got.planes, want.planes, 1e-4)


def test_weighted_sums_are_numbas(device: Device) -> None:
    g = random_scene(60, 7, "erp")
    planes = np.random.default_rng(1).normal(size=(3, CAMERA.height, CAMERA.width)).astype(np.float32)
    got = Renderer(CAMERA, device=device).forward(g, POSE).weighted_sums(planes)
    close(got, Renderer(CAMERA).forward(g, POSE).weighted_sums(planes), 1e-4)


def test_panoramas_of_a_limited_view_are_numbas(device: Device) -> None:
    camera = ErpCamera(80, 40, lat_min_deg=10.0)
    g = random_scene(80, 8, "erp")
    got, want = (Renderer(camera, device=d).forward(g, POSE) for d in (device, None))
    close(got.planes, want.planes, 1e-4)
    np.testing.assert_array_equal(got.opacity == 0, want.opacity == 0)
    assert not got.opacity[32:].any()
    close(got.backward(want.colour).packed, want.backward(want.colour).packed, 1e-3)


def test_a_map_without_gaussians_is_black(device: Device) -> None:
    render = Renderer(CAMERA, device=device).forward(GaussianMap.empty(), POSE)
    assert render.drawn == 0
    assert not render.planes.any()
    assert render.backward(np.ones((36, 72, 3), np.float32)).packed.shape == (0, 14)


def test_a_detached_render_keeps_its_images_on_the_host(device: Device) -> None:
    render = Renderer(CAMERA, device=device).forward(random_scene(20, 9, "erp"), POSE)
    kept = render.detach()
    np.testing.assert_array_equal(kept.planes, render.planes)
    with pytest.raises(RuntimeError, match="detached"):
        kept.backward(kept.colour)


def test_cameras_that_a_device_cannot_draw(device: Device) -> None:
    pinhole = PinholeCamera(70, 50, fx=42.0, fy=45.0, cx=31.0, cy=27.5)
    for camera in (pinhole, ErpCamera(32, 16)):
        assert device_for(device, camera, "sphere") is None
        with pytest.raises(UnsupportedError, match="--device cpu"):
            Renderer(camera, device=device)
    assert device_for(device, CAMERA, "erp") is None
    assert device_for(device, CAMERA, "sphere") is device
    assert device_for(None, CAMERA, "sphere") is None


# -- the optimiser -----------------------------------------------------------------------------------------------------


def on_device(g: GaussianMap, device: Device | None) -> GaussianMap:
    return empty_map(device).concat(g)


def steps(g: GaussianMap, adam: GaussianAdam, device: Device | None, target: Target, count: int) -> list[np.ndarray]:
    """Losses and pose gradients of some steps."""
    renderer = Renderer(CAMERA, device=device)
    said = []
    for _ in range(count):
        loss, pose = adam.photometric_step(renderer.forward(g, POSE), target, RATES, 1e-3, (1e-3, 0.4))
        said.append(np.array([loss, *pose]))
    return said


@pytest.mark.parametrize("opaque", [None, 0.5])
def test_a_mapping_step_is_numbas(device: Device, opaque: float | None) -> None:
    start = random_scene(150, 10, "erp", logit=1.0)
    image = np.random.default_rng(2).integers(0, 256, (CAMERA.height, CAMERA.width, 3)).astype(np.uint8)
    target = Target(image, pixel_weights(CAMERA), gain=0.1, offset=-0.02, knee=0.05, opaque=opaque)
    mine, numbas = on_device(start, device), start.copy()
    got = steps(mine, new_adam(150, 0.8, 0.99, device), device, target, 4)
    want = steps(numbas, GaussianAdam(150, 0.8, 0.99), None, target, 4)
    for a, b in zip(got, want):
        np.testing.assert_allclose(a[0], b[0], rtol=1e-5)
        close(a[1:], b[1:], 2e-3)
    for a, b, first in zip(mine.arrays(), numbas.arrays(), start.arrays()):
        moved = np.linalg.norm(b - first)
        assert moved > 0
        # Adam turns a tiny gradient's sign into a whole step, so some parameters differ by more than by rounding.
        assert np.linalg.norm(a - b) < 0.02 * moved


def test_steps_along_given_gradients_are_numbas(device: Device) -> None:
    start = random_scene(50, 11, "erp")
    grads = np.random.default_rng(3).normal(size=(50, 14)).astype(np.float32)
    grads[3], grads[4, 2], grads[5, 7] = 0, np.nan, np.inf
    mine, numbas = on_device(start, device), start.copy()
    a, b = new_adam(50, 0.9, 0.999, device), GaussianAdam(50, 0.9, 0.999)
    for _ in range(3):
        a.step(mine, grads, RATES, 0.01, (1e-3, 0.3))
        b.step(numbas, grads, RATES, 0.01, (1e-3, 0.3))
    for x, y in zip(mine.arrays(), numbas.arrays()):
        np.testing.assert_allclose(x, y, atol=2e-5)
    np.testing.assert_array_equal(mine.means[3:6], start.means[3:6])


def test_backward_step_is_numbas(device: Device) -> None:
    start = random_scene(80, 12, "erp")
    planes = np.random.default_rng(4).normal(size=(3, CAMERA.height, CAMERA.width)).astype(np.float32)
    mine, numbas = on_device(start, device), start.copy()
    got = new_adam(80, 0.9, 0.999, device).backward_step(
        Renderer(CAMERA, device=device).forward(mine, POSE), planes, RATES
    )
    want = GaussianAdam(80).backward_step(Renderer(CAMERA).forward(numbas, POSE), planes, RATES)
    close(got, want, 1e-4)
    for x, y in zip(mine.arrays(), numbas.arrays()):
        close(x, y, 1e-4)

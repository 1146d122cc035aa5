"""A map that stays on a device is the map of the host: rows come and go alike, and nothing moves unasked."""

from __future__ import annotations

import numpy as np
import pytest
from cuda_devices import DEVICES

from panobench.geometry import Sim3, so3_exp
from panobench.gpu.device import Device, UploadedArrays
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.splat.adam import LearningRates, Target
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer
from panobench.testing.sequences import erp_camera

NAMES = ("means", "log_scales", "quats", "opacity_logits", "colours")


def cloud(n: int, seed: int) -> GaussianMap:
    rng = np.random.default_rng(seed)
    rays = rng.normal(size=(n, 3))
    means = rays / np.linalg.norm(rays, axis=1, keepdims=True) * rng.uniform(1.5, 2.5, (n, 1))
    return GaussianMap(
        means, rng.normal(-2, 0.2, (n, 3)), rng.normal(size=(n, 4)), rng.normal(1, 0.3, n), rng.uniform(size=(n, 3))
    )


@pytest.fixture(params=list(DEVICES))
def device(request: pytest.FixtureRequest) -> Device:
    return DEVICES[request.param]()


@pytest.fixture
def maps(device: Device) -> tuple[TrainableMap, TrainableMap]:
    """One on the device and one on the host."""
    return TrainableMap(0.9, 0.99, device), TrainableMap(0.9, 0.99)


def test_rows_come_and_go_as_on_the_host(maps: tuple[TrainableMap, TrainableMap]) -> None:
    motions = [Sim3(1.1, so3_exp([0.1, 0.2, -0.1]), np.array([0.1, 0.0, -0.2])), Sim3(1.0, np.eye(3), np.zeros(3))]
    for m in maps:
        assert len(m) == 0
        m.append(cloud(50, 0), 0)
        m.append(cloud(30, 1), 1)
        m.drop(np.arange(80) % 7 == 0)
        m.follow(motions)
        m.move(np.arange(len(m)) < 10, motions[0])
        m.append(m.gaussians.select(np.arange(5)), 1)
    mine, hosts = maps
    assert len(mine) == len(hosts) == 73
    np.testing.assert_array_equal(mine.ids, hosts.ids)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(mine.gaussians, name), getattr(hosts.gaussians, name))
        np.testing.assert_array_equal(getattr(mine.gaussians.on_host(), name), getattr(hosts.gaussians, name))
    assert mine.adam.moments[0].shape == hosts.adam.m.shape  # type: ignore[attr-defined]


def test_a_step_leaves_the_map_on_the_device(device: Device, maps: tuple[TrainableMap, TrainableMap]) -> None:
    mine, _ = maps
    mine.append(cloud(100, 2), 0)
    camera = erp_camera(64)
    image = np.zeros((32, 64, 3), np.uint8)
    before = mine.gaussians.means
    render = Renderer(camera, device=device).forward(mine.gaussians, np.eye(4))
    mine.adam.photometric_step(render, Target(image, pixel_weights(camera)), LearningRates(0.01))
    assert not {"means", "log_scales", "colours"} & set(vars(mine.gaussians))
    assert not {"planes", "order"} & set(vars(render))
    assert np.abs(mine.gaussians.means - before).max() > 1e-3
    assert mine.gaussians.means is mine.gaussians.means


def test_the_optimisers_state_follows_its_rows(device: Device, maps: tuple[TrainableMap, TrainableMap]) -> None:
    """Steps before and after dropping and adding rows are those of the host."""
    grads = np.random.default_rng(3).normal(size=(60, 14)).astype(np.float32)
    for m in maps:
        m.append(cloud(40, 3), 0)
        m.adam.step(m.gaussians, grads[:40], LearningRates(0.01))
        m.drop(np.arange(40) < 13)
        m.append(cloud(20, 4), 0)
        m.adam.step(m.gaussians, grads[:47], LearningRates(0.01))
    for name in NAMES:
        np.testing.assert_allclose(getattr(maps[0].gaussians, name), getattr(maps[1].gaussians, name), atol=1e-5)


def test_arrays_of_the_host_cannot_be_written_by_accident(maps: tuple[TrainableMap, TrainableMap]) -> None:
    mine, _ = maps
    mine.append(cloud(10, 5), 0)
    with pytest.raises(ValueError, match="read-only"):
        mine.gaussians.colours += np.float32(1)
    mine.gaussians.update(colours=np.ones((10, 3)))
    np.testing.assert_array_equal(mine.gaussians.colours, 1)
    copy = mine.gaussians.copy()
    copy.colours[:] = 0
    np.testing.assert_array_equal(mine.gaussians.colours, 1)


def test_a_renderer_of_the_host_draws_a_map_of_a_device(maps: tuple[TrainableMap, TrainableMap]) -> None:
    for m in maps:
        m.append(cloud(30, 6), 0)
    mine, hosts = (Renderer(erp_camera(64)).forward(m.gaussians, np.eye(4)) for m in maps)
    np.testing.assert_array_equal(mine.planes, hosts.planes)


def test_uploaded_arrays_are_kept_while_they_live_and_fit(device: Device) -> None:
    kept = UploadedArrays(device.upload, most=1000)
    a, b = np.zeros(100, np.float32), np.ones(100, np.float32)
    first = kept.get(a)
    assert kept.get(a) is first
    kept.get(b)
    assert kept.bytes == 800
    c = np.ones(100, np.float32)
    kept.get(c)
    assert kept.bytes == 800
    assert kept.get(a) is not first
    del c
    assert kept.bytes == 400

"""What can be said of the CUDA kernels without a GPU: they compile, and their barriers are all needed and enough."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from cuda_devices import LaunchedByDriver, emulated
from splat_scenes import POSE, random_scene

from panobench.cameras.erp import ErpCamera
from panobench.geometry import se3_exp
from panobench.gpu import nvrtc
from panobench.gpu.device import Device, download
from panobench.gpu.emulator import Order
from panobench.gpu.errors import DeviceError
from panobench.gpu.source import kernel_names, source
from panobench.photometric.align import Alignment, align
from panobench.photometric.reference import AlignOptions, Reference, ReferenceLevel
from panobench.photometric.warp import ERP
from panobench.splat.cuda.gaussians import DeviceGaussians
from panobench.splat.render import Renderer

#: Barriers in the source: where a batch is staged, in the forward and the backward loop over batches, in the sum of the
#: pose; two in the sums of an alignment, and two in its judgement.
BARRIERS = 8
ORDERS: tuple[Order, ...] = ("forward", "reverse", "random")


def everything(device: Device) -> list[np.ndarray]:
    """Images, gradients and the pose's gradient of a scene whose lists are longer than a batch."""
    g = random_scene(1200, 20, "erp", logit=-3.0)
    g.log_scales += 0.7
    renderer = Renderer(ErpCamera(64, 32), device=device)
    render = renderer.forward(DeviceGaussians.of(g, device), POSE, count_touched=True, sum_weights=True)
    assert int((render.tape.ends - render.tape.starts).max()) > 300  # type: ignore[attr-defined]
    d = np.random.default_rng(5).normal(size=(3, 32, 64)).astype(np.float32)
    gradients = render.backward(d, planar=True)
    found = aligned(device)
    alignment = np.array([*found.T_fr.ravel(), found.cost, found.sigma, found.overlap])
    out = [render.planes, render.depth, render.touched, render.weights, gradients.packed, gradients.pose]
    return [*out, alignment, found.hessian, residuals(device)]  # type: ignore[list-item]


START = se3_exp([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])


def aligned(device: Device) -> Alignment:
    """A few iterations of alignment, at no end that other rounding could move."""
    luma, arrays = scattered()
    reference = Reference([ReferenceLevel(*arrays, np.array([64, 32, 0, 0, 0, 0], np.float32))], ERP)
    options = AlignOptions(iterations=(4,), step_m=0.0, step_rad=0.0)
    return align(reference, [luma], START, options, device=device)


def residuals(device: Device) -> np.ndarray:
    """The histogram of the residuals at the start of the alignment."""
    luma, arrays = scattered()
    state, sums = np.zeros(65), device.zeros(32 + 1024, dtype=torch.float64)
    state[12:24], state[25], state[26] = [*START[:3, :3].ravel(), *START[:3, 3]], 1.0, 10.0
    uploaded = [device.upload(a) for a in (*arrays, luma)]
    device.launch("align_sums", 2, 256, luma.size, *uploaded, 64, 32, 1.0, 0.0, device.upload(state), sums)
    return download(sums)[32:]


def scattered() -> tuple[np.ndarray, list[np.ndarray]]:
    """A luma image, and points (3, n), Jacobians (6, n), values and weights (n,) of its pixels at depths around 2."""
    camera, rng = ErpCamera(64, 32), np.random.default_rng(6)
    luma = cv2.GaussianBlur(rng.random((32, 64)).astype(np.float32), (0, 0), 2.0)
    d = 2 + rng.random(luma.shape)
    X, Y, Z = (camera.rays() * d[..., None]).reshape(-1, 3).T
    gu = 0.5 * (np.roll(luma, -1, 1) - np.roll(luma, 1, 1)).ravel() * 64 / (2 * np.pi)
    gv = np.gradient(luma, axis=0).ravel() * 32 / np.pi
    rho, r2 = np.hypot(X, Z), X * X + Y * Y + Z * Z
    jx, jy = gu * Z / rho**2 - gv * X * Y / (r2 * rho), gv * rho / r2
    jz = -gu * X / rho**2 - gv * Z * Y / (r2 * rho)
    J = np.stack([jx, jy, jz, Y * jz - Z * jy, Z * jx - X * jz, X * jy - Y * jx])
    arrays = (np.stack([X, Y, Z]), J, luma.ravel(), rho / np.sqrt(r2))
    return luma, [np.ascontiguousarray(a, dtype=np.float32) for a in arrays]


def differences(a: list[np.ndarray], b: list[np.ndarray]) -> float:
    """The largest difference, relative to the largest value of its array; NaN if there is one."""
    return float(np.max([np.abs(x - y).max() / np.abs(y).max() for x, y in zip(a, b)]))


@pytest.fixture(scope="module")
def expected() -> list[np.ndarray]:
    return everything(emulated())


@pytest.mark.parametrize("order", ORDERS[1:])
def test_results_do_not_depend_on_the_order_of_threads(expected: list[np.ndarray], order: Order) -> None:
    assert differences(everything(emulated(order)), expected) < 1e-5


@pytest.mark.parametrize("number", range(BARRIERS))
def test_no_barrier_can_be_dropped_unnoticed(expected: list[np.ndarray], number: int) -> None:
    """In some order of threads the result changes, or threads wait for each other for ever."""
    assert emulated().barriers == BARRIERS
    for order in ORDERS:
        try:
            if not differences(everything(emulated(order, number)), expected) < 1e-3:
                return
        except DeviceError:
            return
    pytest.fail("nothing depends on this barrier")


def test_a_kernel_that_does_not_exist() -> None:
    with pytest.raises(DeviceError, match="no kernel"):
        emulated().launch("nothing", 1, 32)


def test_a_kernel_takes_contiguous_tensors_only() -> None:
    device = emulated()
    with pytest.raises(ValueError, match="contiguous"):
        device.launch("forward", 1, 256, torch.zeros(4, 4)[:, :2])


def test_the_kernels_of_the_source_are_found() -> None:
    assert {"project", "forward", "backward", "adam_from_moments"} <= set(kernel_names())
    assert source().count("__global__") == len(kernel_names())


def test_downloads_are_copies() -> None:
    tensor = torch.zeros(3)
    copy = download(tensor)
    tensor += 1
    assert not copy.any()


def test_the_answers_stored_for_devices_are_todays(monkeypatch: pytest.MonkeyPatch) -> None:
    """`benchmarks/device.py --store` writes them anew."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    benchmark = importlib.import_module("device")
    found, stored = benchmark.answers(emulated()), np.load(benchmark.EXPECTED)
    assert set(found) == set(stored.files)
    assert all(benchmark.relative(found[name], stored[name]) < 1e-4 for name in found)


# -- the driver --------------------------------------------------------------------------------------------------------


@pytest.fixture
def by_driver(monkeypatch: pytest.MonkeyPatch) -> LaunchedByDriver:
    stream = SimpleNamespace(cuda_stream=0x987654321)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda _: stream)
    return LaunchedByDriver()


def test_kernels_get_their_arguments_through_the_driver(
    by_driver: LaunchedByDriver, expected: list[np.ndarray]
) -> None:
    assert differences(everything(by_driver), expected) == 0


def test_what_the_driver_refuses_is_an_error_in_its_words(by_driver: LaunchedByDriver) -> None:
    with pytest.raises(RuntimeError, match=r"failed at unknown: named symbol not found \(CUDA error 500\)"):
        by_driver.launch("unknown", 1, 32)
    with pytest.raises(MemoryError, match="too little memory for too_large"):
        by_driver.launch("too_large", 1, 32)
    by_driver.launch("unknown", 0, 32)  # nothing to launch
    with pytest.raises(DeviceError, match="loading the kernels"):
        by_driver._load(by_driver._driver, b"text")


# -- NVRTC, where it is installed --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def architectures() -> list[str]:
    try:
        return nvrtc.architectures()
    except DeviceError as error:
        pytest.skip(str(error))


def test_the_kernels_compile_for_every_architecture(architectures: list[str]) -> None:
    for architecture in architectures:
        assert nvrtc.compile_source(source().encode(), architecture).startswith(b"\x7fELF")


def test_a_mistake_is_reported_in_the_compilers_words(architectures: list[str]) -> None:
    with pytest.raises(DeviceError, match=r"sm_\d+.*wrong"):
        nvrtc.compile_source(b"__global__ void f() { wrong; }", architectures[0])


def test_what_was_compiled_is_kept(
    architectures: list[str], tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    first = nvrtc.compiled(architectures[-1])
    monkeypatch.setattr(nvrtc, "compile_source", lambda *_: pytest.fail("compiled again"))
    assert nvrtc.compiled(architectures[-1]) == first

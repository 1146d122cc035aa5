"""Alignment on a device against that of the CPU: the same steps, hence the same pose, costs and counts."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from cuda_devices import DEVICES

from panobench.cameras.erp import ErpCamera
from panobench.geometry import se3_exp
from panobench.gpu.device import Device
from panobench.photometric.align import Alignment, align
from panobench.photometric.pyramid import F32, pyramid
from panobench.photometric.reference import AlignOptions, Reference, make_reference

CAMERA = ErpCamera(128, 64)
OPTIONS = AlignOptions()
MOTION = se3_exp([0.03, -0.02, 0.04, 0.02, -0.03, 0.01])


@pytest.fixture(params=list(DEVICES))
def device(request: pytest.FixtureRequest) -> Device:
    return DEVICES[request.param]()


def scene(options: AlignOptions = OPTIONS, patch: bool = False) -> tuple[Reference, list[F32]]:
    """A textured sphere of radius 2 m, and a frame of it from ``MOTION`` away; ``patch``: with something that moved."""
    texture = cv2.GaussianBlur(np.random.default_rng(0).random((64, 128)).astype(np.float32), (0, 0), 2.5)
    texture = (texture - texture.min()) / (texture.max() - texture.min())
    reference = make_reference(CAMERA, texture, np.full((64, 128), 2.0, np.float32), 2, options)
    # A point of the sphere that the frame sees at a ray lies on the reference's ray to it.
    R, t = MOTION[:3, :3].T, -MOTION[:3, :3].T @ MOTION[:3, 3]
    rays = CAMERA.rays() @ R.T
    along = -(rays @ t) + np.sqrt((rays @ t) ** 2 + 4 - t @ t)
    pixels, _ = CAMERA.project(rays * along[..., None] + t)
    u, v = (np.asarray(pixels[..., i], np.float32) - np.float32(0.5) for i in (0, 1))
    frame = cv2.remap(np.concatenate([texture] * 2, 1), u % 128, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if patch:
        frame[20:44, 30:60] = 1 - frame[20:44, 30:60]
    return reference, pyramid(frame)


def same(got: Alignment, want: Alignment) -> None:
    assert got.iterations == want.iterations
    np.testing.assert_allclose(got.T_fr, want.T_fr, atol=2e-5)
    np.testing.assert_allclose([got.cost, got.overlap], [want.cost, want.overlap], rtol=1e-3)
    np.testing.assert_allclose(got.sigma, want.sigma, atol=2 * 1.4826 / 4096)
    np.testing.assert_allclose(got.hessian, want.hessian, atol=2e-3 * np.abs(want.hessian).max())


@pytest.mark.parametrize(
    "options",
    [
        OPTIONS,
        replace(OPTIONS, iterations=(3, 2)),
        replace(OPTIONS, rotation_only=True),
        replace(OPTIONS, cut_moving=5.0, cut_moving_min=0.05),
        replace(OPTIONS, cut_moving=math.inf, cut=3.0, cut_levels=2),
    ],
)
def test_a_device_takes_the_steps_of_the_cpu(device: Device, options: AlignOptions) -> None:
    reference, frame = scene(options, patch=True)
    want = align(reference, frame, np.eye(4), options)
    same(align(reference, frame, np.eye(4), options, device=device), want)
    assert want.iterations > 3


def test_it_finds_the_motion(device: Device) -> None:
    reference, frame = scene()
    found = align(reference, frame, np.eye(4), device=device)
    np.testing.assert_allclose(found.T_fr, MOTION, atol=2e-3)
    assert found.overlap > 0.99


def test_levels_gain_and_offset_are_those_asked_for(device: Device) -> None:
    reference, frame = scene()
    frame = [f * np.float32(0.8) + np.float32(0.1) for f in frame]
    for given in ({"finest": 1}, {"coarsest": 0}, {}):
        kwargs = {"gain": math.log(0.8), "offset": 0.1, **given}
        same(align(reference, frame, np.eye(4), device=device, **kwargs), align(reference, frame, np.eye(4), **kwargs))


def test_a_frame_that_shows_nothing_has_no_cost(device: Device) -> None:
    reference, frame = scene()
    found = align(reference, [np.full_like(f, np.nan) for f in frame], np.eye(4), device=device)
    assert found.cost == np.inf
    assert found.iterations == 0


def test_what_a_device_cannot_do_is_done_by_the_cpu(device: Device) -> None:
    options = replace(OPTIONS, exposure=True)
    reference, frame = scene(options)
    want = align(reference, frame, np.eye(4), options)
    np.testing.assert_array_equal(align(reference, frame, np.eye(4), options, device=device).T_fr, want.T_fr)

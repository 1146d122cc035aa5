"""Rolling shutter: images are rotated back row by row, at rates taken from the poses."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.row_times import row_times
from panobench.geometry import make_pose, so3_exp
from panobench.methods.panogs.config import RollingShutterOptions, StitchOptions
from panobench.methods.panogs.rectification.rectify import Rectifier, resampled
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam
from panobench.types import Frame

READOUT = 0.02
OPTIONS = RollingShutterOptions(readout_ms=1e3 * READOUT)


def rectifier_of(camera: Camera, options: RollingShutterOptions = OPTIONS) -> Rectifier:
    return Rectifier(camera, RollingShutter(camera, options), Seam(camera, StitchOptions()))


def world(d: np.ndarray) -> np.ndarray:
    """A smooth picture of the surroundings: colour by direction (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    waves = [np.sin(7 * x + 3 * y), np.cos(6 * y - 4 * z), np.sin(5 * z + 6 * x * y)]
    return np.stack([128 + 110 * w for w in waves], axis=-1)


def seen(camera: Camera, rate: np.ndarray, readout: float = READOUT) -> np.ndarray:
    """The camera's image (H, W, 3) while it rotates at ``rate`` (3,) rad/s."""
    rays = np.nan_to_num(camera.rays())
    R = so3_exp(rate * (readout * row_times(camera, rays))[..., None])
    return np.clip(world(np.einsum("hwij,hwj->hwi", R, rays)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("camera", [ErpCamera(256, 128), ErpCamera(210, 105), PinholeCamera.from_fov(160, 120, 80)])
@pytest.mark.parametrize("rate", [(0.0, 3.5, 0.0), (2.0, -1.0, 1.5)])
def test_a_rotating_camera_sees_what_a_still_one_sees(camera: Camera, rate: tuple[float, float, float]) -> None:
    w = np.array(rate)
    image, still = seen(camera, w), seen(camera, np.zeros(3))
    inner = np.s_[12:-12, 12:-12]  # at a pinhole's rim there is nothing to take
    before = np.abs(image.astype(float) - still)[inner].mean()
    after = np.abs(rectifier_of(camera).turned(image, w).astype(float) - still)[inner].mean()
    assert before > 1.5
    assert after < 0.15 * before + 0.5  # half a level is rounding


@pytest.mark.parametrize("shift", [0.1, 0.2, 0.5, 0.8])
def test_resampling_puts_pixels_where_they_belong(shift: float) -> None:
    """OpenCV's bicubic kernel is off by 0.05 pixels at a fifth of one; rounding to 8 bits averages out."""
    u, v = np.arange(256.0), np.arange(64.0)[:, None]
    phase = (2 * np.pi * 16 / 256) * (u + 7.3 * v)
    image = np.repeat(np.rint(128 + 100 * np.sin(phase))[..., None], 3, axis=2).astype(np.uint8)
    at = np.stack(np.broadcast_arrays(u + shift, v), axis=-1).astype(np.float32)
    moved = resampled(image, at, wrap=True)[..., 0] - 128.0
    found = np.arctan2((moved * np.cos(phase)).sum(), (moved * np.sin(phase)).sum()) * 256 / (2 * np.pi * 16)
    assert found == pytest.approx(shift, abs=0.005)


def test_what_the_camera_travels_is_undone_where_depth_is_known() -> None:
    """In the middle of a painted sphere of radius 2, at 1.5 a second and turning."""
    camera, rate, velocity = ErpCamera(256, 128), np.array([0.0, 2.0, 0.5]), np.array([1.2, -0.4, 0.8])
    rays = camera.rays()
    seconds = READOUT * row_times(camera, rays)
    d = np.einsum("hwij,hwj->hwi", so3_exp(rate * seconds[..., None]), rays)
    start = velocity * seconds[..., None]
    along = (d * start).sum(axis=-1, keepdims=True)
    hit = start + (np.sqrt(along**2 + 4.0 - np.square(start).sum(axis=-1, keepdims=True)) - along) * d
    image = np.clip(world(hit / 2.0), 0, 255).astype(np.uint8)
    still = seen(camera, np.zeros(3)).astype(float)
    rectifier, depth_map = rectifier_of(camera), np.full((128, 256), 2.0, np.float32)
    turned = np.abs(rectifier.turned(image, rate) - still).mean()
    both = np.abs(rectifier.rectified(image, rate, velocity, depth_map) - still).mean()
    unknown = rectifier.rectified(image, rate, velocity, np.full_like(depth_map, np.nan))
    assert both < 0.5 < 0.5 * turned
    np.testing.assert_array_equal(unknown, rectifier.turned(image, rate))


def test_motion_at_the_start_is_that_of_its_poses() -> None:
    times = np.arange(5) / 10
    frames = [Frame(i, float(t), np.zeros((2, 4, 3), np.uint8)) for i, t in enumerate(times)]
    T_wc = {
        i: make_pose(so3_exp(np.array([0.0, t * t, 0.0])), np.array([0.0, 0.0, t * t])) for i, t in enumerate(times)
    }
    shutter = RollingShutter(ErpCamera(64, 32), OPTIONS)
    shutter.know(frames, {i: T for i, T in T_wc.items() if i != 4})
    np.testing.assert_allclose(shutter.predicted_rate(0), 0, atol=1e-9)
    np.testing.assert_allclose(shutter.predicted_rate(3), [0, 0.6, 0], atol=1e-9)
    rate, velocity = shutter.measured(3, 0.3, T_wc[3])
    np.testing.assert_allclose(rate, [0, 0.6, 0], atol=1e-9)
    np.testing.assert_allclose(velocity, T_wc[3][:3, :3].T @ [0, 0, 0.6], atol=1e-9)
    assert shutter.motion(4) is None


def test_a_global_shutter_and_a_still_camera_leave_the_image_alone() -> None:
    camera = ErpCamera(64, 32)
    image = seen(camera, np.zeros(3))
    assert rectifier_of(camera, RollingShutterOptions()).turned(image, np.array([0, 9.0, 0])) is image
    assert rectifier_of(camera).turned(image, np.zeros(3)) is image


@pytest.mark.parametrize("direction", [1, -1])
def test_rates_follow_an_accelerating_camera_in_either_order(direction: int) -> None:
    """Yaw 0.5 a t^2: the rate at t is a t, tracked forwards or backwards."""
    a, times = 4.0, np.arange(6)[::direction] / 15
    poses = [make_pose(so3_exp(np.array([0.0, 0.5 * a * t * t, 0.0])), np.zeros(3)) for t in times]
    shutter = RollingShutter(ErpCamera(64, 32), OPTIONS)
    for t, T in list(zip(times, poses))[:-1]:
        shutter.record(float(t), T)
    np.testing.assert_allclose(shutter.predicted_rate(9), [0, a * times[-1], 0], atol=1e-6)
    np.testing.assert_allclose(shutter.measured(9, float(times[-1]), poses[-1])[0], [0, a * times[-1], 0], atol=1e-6)
    shutter.forget()
    assert not shutter.predicted_rate(9).any()


def test_a_rate_is_measured_on_the_cubic_through_the_last_four_poses() -> None:
    times = np.arange(5) / 15
    poses = [make_pose(so3_exp(np.array([0.0, t**3, 0.0])), np.zeros(3)) for t in times]
    shutter = RollingShutter(ErpCamera(64, 32), OPTIONS)
    for t, T in list(zip(times, poses))[:-1]:
        shutter.record(float(t), T)
    assert shutter.measured(9, float(times[-1]), poses[-1])[0][1] == pytest.approx(3 * times[-1] ** 2, abs=1e-9)

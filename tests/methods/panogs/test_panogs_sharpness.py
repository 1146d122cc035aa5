"""Blurred frames are told from sharp ones by their detail beside the others', and the map learns less of them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.methods.panogs.config import PRESETS, PanogsConfig
from panobench.methods.panogs.mapping.map_optimiser import MapOptimiser
from panobench.methods.panogs.mapping.sharpness import Sharpness
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.views import View
from panobench.splat.render import Renderer

CAMERA = ErpCamera(256, 128)
BLURRED = (3, 7, 8, 15)


def picture(turn: int, streak: int = 1) -> np.ndarray:
    """A textured panorama (128, 256, 3), turned by so many columns, with streaks of so many pixels along the rows."""
    noise = np.random.default_rng(0).normal(size=(128, 256)).astype(np.float32)
    smooth = 128 + 90 * cv2.GaussianBlur(noise, (0, 0), 1.2)
    turned = np.roll(smooth, turn, axis=1)
    wide = np.concatenate([turned[:, -16:], turned, turned[:, :16]], axis=1)
    image = cv2.blur(wide, (streak, 1))[:, 16:-16]
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def looked(camera: Camera, *, streak: int = 5) -> Sharpness:
    found = Sharpness(camera, PanogsConfig().mapping.blurred_below)
    for k in range(20):
        found.look(k, picture(5 * k, streak if k in BLURRED else 1)[: camera.height, : camera.width])
    return found


def test_blurred_frames_get_fewer_steps_and_all_others_the_usual_ones() -> None:
    shares = np.array([looked(CAMERA).share(k) for k in range(20)])
    blurred = np.isin(np.arange(20), BLURRED)
    assert (shares[blurred] < 0.3).all()
    assert (shares[~blurred] == 1).all()
    assert looked(CAMERA).share(99) == 1  # never seen: of a saved map


@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_neither_turning_nor_exposure_looks_like_blur(gain: float) -> None:
    found = Sharpness(CAMERA, PanogsConfig().mapping.blurred_below)
    for k in range(20):
        image = picture(7 * k)
        found.look(k, (image * (gain if k % 2 else 1.0)).astype(np.uint8))
    assert [found.share(k) for k in range(20)] == [1.0] * 20


def test_narrow_views_and_the_paper_look_at_nothing() -> None:
    assert looked(PinholeCamera.from_fov(160, 120, 80)).share(3) == 1
    half = np.zeros((128, 256), bool)
    half[:, :128] = True
    assert looked(CAMERA.with_mask(half)).share(3) == 1
    assert PRESETS["paper"]["mapping.blurred_below"] == 0


def test_the_map_is_trained_on_the_sharp_views() -> None:
    trajectory, config = AnchoredTrajectory(), PanogsConfig()
    rng = np.random.default_rng(1)
    optimiser = MapOptimiser(CAMERA, Renderer(CAMERA), config, TrainableMap(0.9, 0.99, None), trajectory, rng)
    optimiser.sharpness = looked(CAMERA)
    views = [View(k, picture(5 * k), np.eye(4)) for k in range(20)]
    trajectory.frames += views[8:]
    optimiser.window = views[7::-1]
    steps = optimiser._schedule(400)
    counts = np.bincount([v.index for v in steps], minlength=20)
    assert len(steps) == 400
    assert counts[7] < counts[[0, 1, 2, 4, 5, 6]].min()  # were it sharp, the newest would be in every round
    assert counts[[8, 15]].max() < 0.5 * counts[[9, 10, 11, 12]].mean()

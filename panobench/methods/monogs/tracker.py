"""Pose and exposure of a frame by Adam on the rendering loss, against a map that is held fixed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise, se3_exp
from panobench.methods.monogs.config import MonogsConfig
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.loss import photometric_loss
from panobench.splat.render import Render, Renderer

Array = NDArray[np.float64]


@dataclass
class CameraAdam:
    """Adam on (translation, rotation, gain, offset), (8,); T_cw <- exp(step) T_cw."""

    rates: Array
    T_cw: Array
    exposure: Array
    steps: int = 0

    def __post_init__(self) -> None:
        self.m, self.v = np.zeros(8), np.zeros(8)

    def step(self, d_pose: Array, d_exposure: tuple[float, float]) -> float:
        """Returns the length of the pose's step."""
        gradient = np.concatenate([d_pose, d_exposure])
        self.steps += 1
        self.m = 0.9 * self.m + 0.1 * gradient
        self.v = 0.999 * self.v + 0.001 * gradient**2
        mean, spread = self.m / (1 - 0.9**self.steps), np.sqrt(self.v / (1 - 0.999**self.steps))
        move = -self.rates * mean / (spread + 1e-8)
        self.T_cw = renormalise(se3_exp(move[:6]) @ self.T_cw)
        self.exposure = self.exposure + move[6:]
        return float(np.linalg.norm(move[:6]))


def camera_rates(config: MonogsConfig, scale: float = 1.0) -> Array:
    """(8,) rates of ``CameraAdam``; ``scale`` applies to the pose."""
    pose = np.repeat([config.translation_rate, config.rotation_rate], 3) * scale
    return np.concatenate([pose, np.full(2, config.exposure_rate)])


@dataclass
class TrackedFrame:
    T_wc: Array
    gain: float
    offset: float
    loss: float
    iterations: int
    render: Render


def bright(config: MonogsConfig, image: NDArray[np.uint8], valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W): pixels that show something."""
    return np.asarray(valid & (image.sum(axis=2, dtype=np.int64) > 255 * config.black_threshold))


def edges(config: MonogsConfig, image: NDArray[np.uint8], shown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W): of the ``shown`` pixels those whose gradient exceeds the median by a factor; tracking uses only these."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    gx, gy = cv2.Scharr(grey, cv2.CV_32F, 1, 0), cv2.Scharr(grey, cv2.CV_32F, 0, 1)
    steep = np.sqrt(gx * gx + gy * gy)  # cv2.magnitude's last bit depends on where the array lies in memory
    if not shown.any():
        return shown
    return np.asarray(shown & (steep > config.edge_threshold * np.median(steep[shown])))


def track(
    config: MonogsConfig,
    renderer: Renderer,
    gaussians: GaussianMap,
    image: NDArray[np.uint8],
    valid: NDArray[np.bool_],
    T_wc: Array,
) -> TrackedFrame:
    """From the pose ``T_wc``. Uniform L1, times the rendered opacity, on edges."""
    mask = edges(config, image, bright(config, image, valid)) / np.float32(image.shape[0] * image.shape[1])
    camera = CameraAdam(camera_rates(config), invert_pose(T_wc), np.zeros(2))
    loss, count = float("inf"), 0
    for _ in range(config.tracking_iterations):
        out = renderer.forward(gaussians, invert_pose(camera.T_cw))
        weights: F32 = (mask * out.opacity).astype(np.float32)
        loss, d_planes, d_exposure = photometric_loss(out.planes, image, weights, *camera.exposure)
        count += 1
        if camera.step(out.backward(d_planes, planar=True).pose, d_exposure) < config.converged:
            break
    T = invert_pose(camera.T_cw)
    render = renderer.forward(gaussians, T, count_touched=True)
    return TrackedFrame(T, float(camera.exposure[0]), float(camera.exposure[1]), loss, count, render)

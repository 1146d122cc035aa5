"""Rotation between two panoramas: yaw by circular phase correlation, the rest from tangent windows.

Phase correlation: Kuglin and Hines 1975. Rotation from matched directions: Wahba 1965, solved by SVD.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench import Camera, Estimate, Frame, MethodContext, OnlineMethod, Options, Trajectory, option
from panobench.geometry import directions_from_lonlat, make_pose, renormalise, so3_exp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RotationConfig(Options):
    """Tangent windows and their alignment."""

    windows_per_ring: int = option(8, "tangent windows on each of three circles of latitude", above=0)
    window_px: int = option(32, "side of a window", unit="px", above=0)
    window_fov_deg: float = option(50.0, "field of view of a window", unit="deg", above=0, below=180)
    iterations: int = option(3, "times the windows are matched and the rotation is solved")
    min_contrast: float = option(2.0, "a frame of less contrast is lost", unit="grey levels")


class Rotation(OnlineMethod):
    """Chains the rotations from frame to frame. The camera stays at the origin."""

    def __init__(self, config: RotationConfig | None = None) -> None:
        self.config = config or RotationConfig()

    def start(self, camera: Camera, context: MethodContext) -> None:
        self._camera = camera
        self._frames = _window_frames(self.config)
        self._windows = _window_rays(self.config, *self._frames)
        self._hann = np.outer(*[np.hanning(self.config.window_px)] * 2)
        self._previous: Array | None = None
        self._R_wc = np.eye(3)
        self._times: list[float] = []
        self._poses: list[Array] = []

    def track(self, frame: Frame) -> Array | None:
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY).astype(np.float64)
        if grey.std() < self.config.min_contrast:
            return None  # lost for this frame; the next one is compared with the last good one
        if self._previous is not None:
            self._R_wc = renormalise(make_pose(self._R_wc @ self._relative(self._previous, grey), np.zeros(3)))[:3, :3]
        self._previous = grey
        pose = make_pose(self._R_wc, np.zeros(3))
        self._times.append(frame.time)
        self._poses.append(pose)
        return pose

    def finish(self) -> Estimate:
        poses = np.stack(self._poses) if self._poses else np.zeros((0, 4, 4))
        return Estimate(Trajectory(np.array(self._times), poses), extra={"model": "rotation only"})

    def _relative(self, a: Array, b: Array) -> Array:
        """R (3, 3) with ray_a = R ray_b, from two grey panoramas."""
        R = so3_exp([0.0, _yaw(a, b), 0.0])
        centres, right, down = self._frames
        reference = np.fft.rfft2(self._sample(a, self._windows) * self._hann)
        scale = 2 * np.tan(np.radians(self.config.window_fov_deg / 2)) / self.config.window_px
        for _ in range(self.config.iterations):
            moved = np.fft.rfft2(self._sample(b, self._windows @ R) * self._hann)  # ray_b = R^T ray_a
            shift, weight = _shifts(reference, moved, self.config.window_px)
            seen = centres + scale * (shift[:, :1] * right + shift[:, 1:] * down)
            weight[np.abs(shift).max(axis=1) > self.config.window_px / 4] = 0.0
            R = _wahba(centres, seen / np.linalg.norm(seen, axis=1, keepdims=True), weight) @ R
        return R

    def _sample(self, image: Array, rays: Array) -> NDArray[np.float64]:
        """Bilinear samples (..., ) of a panorama at rays (..., 3), wrapping at the seam."""
        pixels, _ = self._camera.project(rays)
        uv = (pixels - 0.5).astype(np.float32).reshape(-1, rays.shape[-2], 2)
        flat = cv2.remap(image, uv, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # type: ignore[call-overload]
        return np.asarray(flat, dtype=np.float64).reshape(rays.shape[:-1])


def _yaw(a: Array, b: Array) -> float:
    """Yaw in radians by which camera b is turned to the right of a, to the nearest pixel."""
    rows = slice(a.shape[0] // 4, a.shape[0] * 3 // 4)
    fa, fb = np.fft.rfft2(a[rows]), np.fft.rfft2(b[rows])
    surface = np.fft.irfft2(_whitened(fa * np.conj(fb)), s=a[rows].shape)
    shift = int(np.argmax(surface) % a.shape[1])  # content of b lies `shift` px to the left of a's
    if shift > a.shape[1] // 2:
        shift -= a.shape[1]
    return shift / a.shape[1] * 2 * np.pi


def _whitened(cross: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Cross spectrum with equal magnitudes, except for those far below the mean, which are noise."""
    size = np.abs(cross)
    return np.asarray(cross / (size + 0.1 * size.mean(axis=(-2, -1), keepdims=True) + 1e-12))


def _shifts(fa: NDArray[np.complex128], fb: NDArray[np.complex128], size: int) -> tuple[Array, Array]:
    """Shifts (K, 2) in pixels of windows b relative to a, from their spectra, and the heights (K,) of the peaks."""
    surface = np.fft.irfft2(_whitened(fb * np.conj(fa)), s=(size, size))
    k = np.arange(len(surface))
    y, x = np.divmod(surface.reshape(len(surface), -1).argmax(axis=1), size)
    peak = surface[k, y, x]
    shift = []
    for before, after, at in (
        (surface[k, y, x - 1], surface[k, y, (x + 1) % size], x),
        (surface[k, y - 1, x], surface[k, (y + 1) % size, x], y),
    ):
        bend = before - 2 * peak + after  # vertex of the parabola through three samples
        vertex = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, 1.0), 0.0)
        shift.append((at + size // 2) % size - size // 2 + vertex)
    return np.stack(shift, axis=1), np.maximum(peak, 0.0)


def _window_frames(config: RotationConfig) -> tuple[Array, Array, Array]:
    """Centre, right and down direction of every window: unit vectors (K, 3), three rings of latitude."""
    step = 2 * np.pi / config.windows_per_ring
    lon = np.concatenate([(np.arange(config.windows_per_ring) + shift) * step for shift in (0.0, 0.5, 0.0)])
    lat = np.repeat(np.radians([-35.0, 0.0, 35.0]), config.windows_per_ring)
    centres = directions_from_lonlat(lon, lat)
    right = np.stack([np.cos(lon), np.zeros_like(lon), -np.sin(lon)], axis=-1)
    return centres, right, np.cross(centres, right)


def _window_rays(config: RotationConfig, centres: Array, right: Array, down: Array) -> Array:
    """Rays of all tangent windows, (K, S, S, 3), not normalised."""
    half = np.tan(np.radians(config.window_fov_deg / 2))
    axis = ((np.arange(config.window_px) + 0.5) / config.window_px * 2 - 1) * half
    across = axis[:, None] * right[:, None]  # (K, S, 3)
    along = axis[:, None] * down[:, None]
    return np.asarray(centres[:, None, None] + across[:, None] + along[:, :, None])


def _wahba(a: Array, b: Array, weights: Array) -> Array:
    """Rotation R (3, 3) that minimises the weighted squared distance of a_i and R b_i, for rays (K, 3)."""
    U, _, Vt = np.linalg.svd((a * weights[:, None]).T @ b)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)

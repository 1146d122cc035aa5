"""Tiny synthetic sequences with exact truth: a textured box seen by any camera, rendered in milliseconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.geometry import make_pose, so3_exp, so3_log
from panobench.types import Imu, Trajectory

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.cameras.rig import Rig

HALF_SIZE = np.array([2.5, 1.5, 2.0])  # of the room, metres
GRAVITY = np.array([0.0, 9.81, 0.0])  # world axes as the camera's at rest: y points down


def erp_camera(width: int = 128) -> Camera:
    """A full equirectangular camera, made through the registry like any other."""
    from panobench.plugins import registry
    from panobench.specs import CameraSpec

    cls = registry().get(CameraSpec, "erp").load()
    camera: Camera = cls.from_dict({"model": "erp", "width": width, "height": width // 2})
    return camera


def two_lenses(width: int = 96, baseline_m: float = 0.041) -> Rig:
    """Two fisheye lenses of 190 degrees back to back, ``baseline_m`` apart along the rig's z axis."""
    from panobench.cameras.rig import Rig, RigLens
    from panobench.cameras.views import look_rotation
    from panobench.testing.cameras import fisheye_camera

    camera = fisheye_camera(width, 190.0)
    half = np.array([0.0, 0.0, 0.5 * baseline_m])
    back = make_pose(look_rotation(180.0).T, -half)
    return Rig((RigLens(camera, make_pose(np.eye(3), half)), RigLens(camera, back)))


def smooth_pose(t: float) -> NDArray[np.float64]:
    """(4, 4): a gentle loop with some yaw, pitch and roll; at most 0.5 m from the middle."""
    R = so3_exp([0.10 * np.sin(1.7 * t), 0.45 * np.sin(0.8 * t), 0.06 * np.sin(1.1 * t)])
    return make_pose(R, [0.5 * np.sin(0.9 * t), 0.1 * np.sin(1.3 * t), 0.4 * (1 - np.cos(0.9 * t))])


def rotating_pose(t: float) -> NDArray[np.float64]:
    """(4, 4): rotation about the camera's centre only, mostly yaw."""
    return make_pose(so3_exp([0.08 * np.sin(1.3 * t), 0.6 * t, 0.05 * np.sin(0.9 * t)]), np.zeros(3))


class TinySequence(FrameSequence):
    """A box room with a smooth procedural texture, ray-cast in numpy; exact poses, depth and IMU.

    pose: time in seconds -> ``T_wc``; ``smooth_pose`` or ``rotating_pose`` or your own (stay within the room,
    half its size is ``HALF_SIZE``). rig: lenses whose pictures ``lens_images`` has, each seen from its own centre.
    T_body_cam (4, 4): what the inertial samples say of the camera on the body; they stay those of the camera.
    """

    dataset = "testing"

    def __init__(
        self,
        camera: Camera | None = None,
        n: int = 8,
        *,
        rate: float = 10.0,
        pose: Callable[[float], NDArray[np.float64]] = smooth_pose,
        seed: int = 0,
        name: str = "tiny",
        rig: Rig | None = None,
        T_body_cam: NDArray[np.float64] | None = None,
    ) -> None:
        self.camera = camera if camera is not None else erp_camera()
        self.times = np.arange(n) / rate
        self.name = name
        self._pose, self._rig, self._T_body_cam = pose, rig, T_body_cam
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=(24, 3))
        self._waves = direction * np.geomspace(2.0, 25.0, 24)[:, None] / np.linalg.norm(direction, axis=1)[:, None]
        self._phases = rng.uniform(0, 2 * np.pi, size=(24, 3))
        self._weights = 1.0 / np.linalg.norm(self._waves, axis=1) ** 0.5

    def _hits(self, T_wc: NDArray[np.float64], rays: NDArray[np.float64]) -> tuple[Any, Any]:
        """Distance (H, W) to the walls and the points hit (H, W, 3); NaN rays give NaN."""
        directions = rays @ T_wc[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.min((np.sign(directions) * HALF_SIZE - T_wc[:3, 3]) / directions, axis=-1)
        return distance, T_wc[:3, 3] + distance[..., None] * directions

    def pose_at(self, t: float) -> NDArray[np.float64]:
        """True ``T_wc`` (4, 4) at any time."""
        return np.asarray(self._pose(t))

    def image_from(self, T_wc: NDArray[np.float64], camera: Camera | None = None) -> NDArray[np.uint8]:
        """What a camera sees from any pose: RGB (H, W, 3) uint8, black where it has no ray."""
        camera = camera or self.camera
        _, points = self._hits(T_wc, camera.rays())
        angle = np.asarray(points @ self._waves.T, dtype=np.float32)  # (H, W, K)
        weights = self._weights[:, None] / self._weights.sum()
        sine, cosine = np.cos(self._phases) * weights, np.sin(self._phases) * weights
        colour = np.sin(angle) @ sine.astype(np.float32) + np.cos(angle) @ cosine.astype(np.float32)
        value = 127.5 + 120 * np.tanh(4.0 * colour)
        value[~camera.valid_mask()] = 0.0
        return np.asarray(np.nan_to_num(value), dtype=np.uint8)

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.image_from(self.pose_at(float(self.times[index])))

    @property
    def rig(self) -> Rig | None:
        return self._rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        T_wc = self.pose_at(float(self.times[index]))
        lenses = () if self._rig is None else self._rig.lenses
        return tuple(self.image_from(T_wc @ lens.T_rig_lens, lens.camera) for lens in lenses)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        distance, _ = self._hits(self.pose_at(float(self.times[index])), self.camera.rays())
        return np.asarray(np.where(self.camera.valid_mask(), distance, np.nan), dtype=np.float32)

    @property
    def groundtruth(self) -> Trajectory | None:
        return Trajectory(self.times, np.stack([self.pose_at(float(t)) for t in self.times]))

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return -GRAVITY / np.linalg.norm(GRAVITY)

    @property
    def imu(self) -> Imu | None:
        """200 Hz, camera axes, noise-free, from central differences of the pose."""
        dt = 1e-3
        times = np.arange(self.times[0], self.times[-1] + 1e-9, 1 / 200.0)
        gyro, accel = np.zeros((len(times), 3)), np.zeros((len(times), 3))
        for i, t in enumerate(times):
            before, now, after = (self.pose_at(float(t + k * dt)) for k in (-1, 0, 1))
            gyro[i] = so3_log(before[:3, :3].T @ after[:3, :3]) / (2 * dt)
            acceleration = (before[:3, 3] - 2 * now[:3, 3] + after[:3, 3]) / dt**2
            accel[i] = now[:3, :3].T @ (acceleration - GRAVITY)
        return Imu(times, gyro, accel, self._T_body_cam)

    def provenance(self) -> dict[str, Any]:
        return {"generator": "panobench.testing", "frames": len(self)}


class GivenImages(FrameSequence):
    """Given images at 10 frames/s, without any truth, to test black, grey, repeated or odd input."""

    dataset = "testing"

    def __init__(self, camera: Camera, images: list[NDArray[np.uint8]], name: str = "given") -> None:
        self.camera, self._images, self.name = camera, images, name
        self.times = np.arange(len(images)) / 10.0

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._images[index].copy()


class BlindSequence(FrameSequence):
    """A sequence without ground truth, depth and novel views, as a batch method sees it.

    ``asked`` lists which of them the method asked for.
    """

    def __init__(self, inner: FrameSequence, *, imu: bool = False) -> None:
        self._inner, self._imu = inner, imu
        self.camera, self.times = inner.camera, inner.times
        self.name, self.dataset = inner.name, inner.dataset
        self.asked: list[str] = []

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._inner.image(index)

    def frame_name(self, index: int) -> str:
        return self._inner.frame_name(index)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        self.asked.append("depth")
        return None

    @property
    def groundtruth(self) -> Trajectory | None:
        self.asked.append("groundtruth")
        return None

    @property
    def imu(self) -> Imu | None:
        return self._inner.imu if self._imu else None

    @property
    def rig(self) -> Rig | None:
        return self._inner.rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        return self._inner.lens_images(index)

    def novel_views(self) -> list[Any]:
        self.asked.append("novel_views")
        return []

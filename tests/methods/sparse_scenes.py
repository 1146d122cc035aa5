"""A textured box seen by any camera: ray-cast images with exact poses, for the tests of ``sparse``."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import make_pose, so3_exp

HALF = np.array([3.0, 1.4, 2.2])


def _texture(seed: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    out = np.full((512, 512), 128.0, np.float32)
    for cells, amplitude in ((24, 40.0), (64, 35.0), (128, 25.0)):
        out += amplitude * cv2.resize(
            rng.uniform(-1, 1, (cells, cells)).astype(np.float32), (512, 512), interpolation=2
        )
    return np.clip(out, 0, 255)


TEXTURES = [_texture(i) for i in range(6)]


def view(camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.uint8]:
    """RGB image (H, W, 3) of the box's inside."""
    rays = np.nan_to_num(camera.rays()) @ T_wc[:3, :3].T
    origin = T_wc[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(rays > 0, HALF - origin, -HALF - origin) / rays
    reach = np.where(np.isfinite(reach), reach, np.inf)
    axis = np.argmin(reach, axis=-1)
    with np.errstate(invalid="ignore"):
        hit = origin + rays * np.take_along_axis(reach, axis[..., None], -1)
    out = np.zeros(axis.shape, np.float32)
    for wall in range(6):
        a = wall // 2
        side = (axis == a) & ((np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0) == (wall % 2 == 1))
        u, v = (hit[..., i] for i in range(3) if i != a)
        tex = cv2.remap(
            TEXTURES[wall],
            ((u + 3.2) * 79).astype(np.float32),
            ((v + 3.2) * 79).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        out = np.where(side, tex, out)
    out = np.where(np.isfinite(camera.rays()).all(axis=-1), out, 0)
    return np.repeat(np.round(out).astype(np.uint8)[..., None], 3, axis=-1)


def walk(n: int, step: float = 0.04) -> NDArray[np.float64]:
    """Smooth camera-to-world poses (n, 4, 4) inside the box."""
    s = np.arange(n) * step
    t = np.stack([np.sin(s * 1.5) - 0.3 * s, 0.15 * np.sin(3 * s), s - 0.5], axis=-1)
    w = np.stack([0.1 * np.sin(2 * s), 0.5 * s, 0.08 * np.sin(1.7 * s)], axis=-1)
    return make_pose(so3_exp(w), t)

"""Pictures that are functions on the sphere, so that every camera's true image of them is known."""

from __future__ import annotations

import numpy as np

from panobench.cameras.base import Camera


def smooth(rays: np.ndarray, frequency: float = 5.0) -> np.ndarray:
    """Three channels in 0..1 without a seam or a pole."""
    x, y, z = np.moveaxis(rays * frequency, -1, 0)
    waves = [np.sin(x) * np.cos(y + 1), np.sin(y - z), np.cos(z + 0.5) * np.sin(x + y)]
    return np.stack(waves, axis=-1) / 2 + 0.5


def picture(camera: Camera, R_camera_world: np.ndarray | None = None, frequency: float = 5.0) -> np.ndarray:
    """(H, W, 3) float32 as the camera, its axes turned by R, sees it; 0 where it sees nothing."""
    rays = camera.rays() if R_camera_world is None else camera.rays() @ R_camera_world
    return np.nan_to_num(smooth(rays, frequency)).astype(np.float32)


def zone_plate(rays: np.ndarray, rings: float) -> np.ndarray:
    """cos of a phase growing with the square of the angle from +x: ever finer rings around the right side."""
    angle = np.arccos(np.clip(rays[..., 0], -1, 1))
    return 0.5 + 0.5 * np.cos(rings * angle**2)

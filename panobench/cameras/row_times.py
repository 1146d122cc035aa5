"""When each pixel of a rolling-shutter camera is read."""

from __future__ import annotations

import numpy as np

from panobench.cameras.base import Array, Camera

#: The circle of a panoramic camera's lens reaches this far from its axis, radians: its rows are read over that angle.
LENS_REACH = np.deg2rad(95.0)


def row_times(camera: Camera, rays: Array) -> Array:
    """When the row of each ray (H, W, 3) is read, (H, W) in -1/2..1/2 of the readout.

    A panorama is taken to come from two equidistant fisheye lenses along +z and -z whose rows run down; other cameras
    have their own rows.
    """
    if camera.kind != "erp":
        pixels, _ = camera.project(rays.reshape(-1, 3))
        row = np.clip(pixels[:, 1] / camera.height - 0.5, -0.5, 0.5)
        return np.nan_to_num(row).reshape(rays.shape[:2])
    across = np.hypot(rays[..., 0], rays[..., 1])
    theta = np.arctan2(across, np.abs(rays[..., 2]))
    return np.asarray(0.5 * theta / LENS_REACH * rays[..., 1] / np.maximum(across, 1e-12))

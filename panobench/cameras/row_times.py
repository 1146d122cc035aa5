"""When each pixel of a rolling-shutter camera is read, and how the camera turned meanwhile."""

from __future__ import annotations

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.cameras.rig import Rig
from panobench.cameras.rig_panorama import LensCentres, RigPanorama
from panobench.geometry import so3_log

#: The circle of a panoramic camera's lens reaches this far from its axis, radians: its rows are read over that angle.
LENS_REACH = np.deg2rad(95.0)


def row_times(camera: Camera, rays: Array) -> Array:
    """When the row of each ray (H, W, 3) is read, (H, W) in -1/2..1/2 of the readout.

    A panorama is taken to come from two equidistant fisheye lenses along +z and -z whose rows run down; that of a rig
    has its lenses' rows, and other cameras have their own.
    """
    if isinstance(camera, RigPanorama) and camera.rig is not None:
        return rig_row_times(camera.rig, rays.reshape(-1, 3)).reshape(rays.shape[:2])
    if camera.kind != "erp":
        pixels, _ = camera.project(rays.reshape(-1, 3))
        row = np.clip(pixels[:, 1] / camera.height - 0.5, -0.5, 0.5)
        return np.nan_to_num(row).reshape(rays.shape[:2])
    across = np.hypot(rays[..., 0], rays[..., 1])
    theta = np.arctan2(across, np.abs(rays[..., 2]))
    return np.asarray(0.5 * theta / LENS_REACH * rays[..., 1] / np.maximum(across, 1e-12))


def rig_row_times(rig: Rig, rays: Array) -> Array:
    """The same for rays (N, 3) in a rig's axes, (N,): each is read by the lens whose axis is nearest to it.

    Where the lenses say how long theirs takes, a half is half of the longest readout.
    """
    nearest = LensCentres.of(rig).nearest(rays)
    rows, longest = np.zeros(len(rays)), rig.readout_s
    for number, lens in enumerate(rig.lenses):
        own = nearest == number
        pixels, _ = lens.camera.project(rays[own] @ lens.T_rig_lens[:3, :3])
        share = (lens.readout_s or 0.0) / longest if longest else 1.0
        rows[own] = share * np.nan_to_num(np.clip(pixels[:, 1] / lens.camera.height - 0.5, -0.5, 0.5))
    return rows


def rates_along(times: Array, T_wc: Array) -> Array:
    """Angular velocities (N, 3) at ``times`` (N,) along poses (N, 4, 4), rad/s in the camera's axes.

    At a pose, the mean of the rates before and after it, each weighted by the other's time; at the ends they are
    extrapolated.
    """
    if len(T_wc) < 2:
        return np.zeros((len(T_wc), 3))
    steps = np.swapaxes(T_wc[:-1, :3, :3], 1, 2) @ T_wc[1:, :3, :3]
    dt = np.maximum(np.diff(times), 1e-6)[:, None]
    between = so3_log(steps) / dt
    if len(between) == 1:
        return np.repeat(between, 2, axis=0)
    slopes = (between[1:] - between[:-1]) / (0.5 * (dt[1:] + dt[:-1]))
    middle = between[:-1] + 0.5 * dt[:-1] * slopes
    first, last = between[:1] - 0.5 * dt[:1] * slopes[:1], between[-1:] + 0.5 * dt[-1:] * slopes[-1:]
    return np.concatenate([first, middle, last])


def velocities_along(times: Array, T_wc: Array) -> Array:
    """Velocities (N, 3) at ``times`` (N,) along poses (N, 4, 4), per second in the camera's axes."""
    if len(T_wc) < 3:
        return np.zeros((len(T_wc), 3))
    velocity = np.gradient(T_wc[:, :3, 3], times, axis=0, edge_order=2)
    return np.asarray(np.einsum("nji,nj->ni", T_wc[:, :3, :3], velocity))


def rotated(rays: Array, seconds: Array, rate: Array) -> Array:
    """Rays (..., 3), each rotated by ``rate`` (3,) or (..., 3), rad/s, for its own time (...) (Rodrigues' formula)."""
    speed = np.linalg.norm(rate, axis=-1)
    axis = rate / np.maximum(speed, 1e-12)[..., None]
    angle = (speed * seconds)[..., None]
    along = (rays * axis).sum(axis=-1, keepdims=True) * axis
    return np.asarray(rays * np.cos(angle) + np.cross(axis, rays) * np.sin(angle) + along * (1 - np.cos(angle)))

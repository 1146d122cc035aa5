"""Named viewing directions, and the three perspective views in which the paper evaluates rendering.

A rotation ``R_target_source`` rotates a vector from the source camera's axes to the view's: p_t = R p_s. Its rows are
the view's x (right), y (down) and z (forward) axes written in the source's axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from panobench.cameras.base import Array, Camera
from panobench.errors import UnknownNameError, UsageError
from panobench.geometry import make_pose

if TYPE_CHECKING:
    from panobench.cameras.pinhole import PinholeCamera

#: name -> longitude (to the right) and latitude (upwards) of the viewing direction, degrees.
VIEW_DIRECTIONS: dict[str, tuple[float, float]] = {
    "front": (0.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "back": (180.0, 0.0),
    "up": (0.0, 90.0),
    "down": (0.0, -90.0),
}

#: The paper's rendering protocol: these directions, 120 x 60 degrees.
PAPER_VIEWS = ("front", "left", "right")
PAPER_FOV_DEG = (120.0, 60.0)


class View(NamedTuple):
    """A perspective view of a panorama: its name, camera and rotation from the panorama's axes."""

    name: str
    camera: PinholeCamera
    R_target_source: Array


def look_rotation(lon_deg: float, lat_deg: float = 0.0, roll_deg: float = 0.0) -> Array:
    """R_target_source (3, 3) of a view towards ``lon_deg``, ``lat_deg`` of the source.

    The view yaws by lon about the vertical, then pitches up by lat, then rolls clockwise, seen from behind the camera,
    by roll about its own forward axis. Looking straight up, the bottom of the image is the forward side.
    """
    a, b, c = np.deg2rad([lon_deg, lat_deg, roll_deg])
    yaw = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    roll = np.array([[np.cos(c), np.sin(c), 0], [-np.sin(c), np.cos(c), 0], [0, 0, 1]])
    R = roll @ tilt @ yaw
    exact = np.round(R)  # rotations by multiples of 90 degrees stay exact
    return np.where(np.abs(R - exact) < 1e-15, exact, R) + 0.0


def view_rotation(name: str) -> Array:
    """R_target_source (3, 3) of a named view, or of "LON,LAT" or "LON,LAT,ROLL" in degrees. Raises UnknownNameError."""
    if name in VIEW_DIRECTIONS:
        return look_rotation(*VIEW_DIRECTIONS[name])
    parts = name.split(",")
    if len(parts) in (2, 3):
        try:
            angles = [float(p) for p in parts]
        except ValueError:
            pass
        else:
            if not (np.isfinite(angles).all() and -90 <= angles[1] <= 90):
                raise UsageError(f"view '{name}': a latitude lies in -90..90 degrees")
            return look_rotation(*angles)
    raise UnknownNameError("view", name, VIEW_DIRECTIONS)


def pinhole_views(
    names: Iterable[str] = PAPER_VIEWS, width: int = 480, fov_deg: tuple[float, float] = PAPER_FOV_DEG
) -> list[View]:
    """Perspective views in the given directions; by default the paper's three of 120 x 60 degrees."""
    from panobench.cameras.pinhole import PinholeCamera

    camera = PinholeCamera.from_fov(width, *fov_deg)
    return [View(name, camera, view_rotation(name)) for name in names]


def paper_views(width: int = 480) -> list[View]:
    """The paper's three views: front, left and right, 120 x 60 degrees."""
    return pinhole_views(PAPER_VIEWS, width, PAPER_FOV_DEG)


def rotated_poses(T_wc_source: ArrayLike, R_target_source: ArrayLike) -> Array:
    """Camera-to-world poses (..., 4, 4) of a camera at the same position whose axes are rotated by R_target_source."""
    R_source_target = np.asarray(R_target_source, dtype=np.float64).T
    return np.asarray(np.asarray(T_wc_source, dtype=np.float64) @ make_pose(R_source_target, np.zeros(3)))


def upright_rotation(camera: Camera) -> Array:
    """R_upright_camera (3, 3): from a camera's axes to axes in which its panorama is upright.

    An annular lens (`pal`) is mounted with its axis vertical: its horizon is what other cameras call front. An ERP ray
    (x, y, z) is (x, z, -y) in its axes. Other cameras are upright already.
    """
    return view_rotation("up").T if camera.kind == "pal" else np.eye(3)

"""What a camera sees, as angles and in words for messages."""

from __future__ import annotations

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.geometry import lonlat_from_directions


def view_extent(camera: Camera, R: Array | None = None) -> tuple[float, float, float, float] | None:
    """Smallest longitude arc (start, end) and latitude range of the valid rays, degrees; None if there are none.

    R: rotates the rays first. The end of the arc may exceed 180 if it crosses the seam; the full circle is -180..180.
    """
    rays = camera.rays()[camera.valid_mask()]
    if len(rays) == 0:
        return None
    lon, lat = np.rad2deg(lonlat_from_directions(rays if R is None else rays @ R.T))
    step = 2.0
    used = np.flatnonzero(np.bincount(((lon + 180) / step).astype(int) % 180, minlength=180))
    gaps = np.diff([*used, used[0] + 180])
    widest = int(np.argmax(gaps))
    if gaps[widest] <= 2:
        start, end = -180.0, 180.0
    else:
        start = float(used[(widest + 1) % len(used)] * step - 180)
        end = float(used[widest] * step + step - 180)
        end += 360 if end <= start else 0
    return start, end, float(lat.min()), float(lat.max())


def describe_view(camera: Camera, R: Array | None = None) -> str:
    """For messages: "longitude -60..60, latitude -30..30 deg". R: rotates the camera's rays first."""
    extent = view_extent(camera, R)
    if extent is None:
        return "nothing (no valid pixel)"
    return "longitude {:.0f}..{:.0f}, latitude {:.0f}..{:.0f} deg".format(*extent)

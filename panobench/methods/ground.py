"""How high the camera is above what it sees below: evidence of a scale that drifts (see ``verdict.height``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

#: Angles below the horizon between which the ground is looked at, radians: under furniture's tops, above who carries
#: the camera.
NEAREST, FARTHEST = np.deg2rad(60.0), np.deg2rad(25.0)
#: Fewer directions than this say nothing.
ENOUGH = 20


def height_above_ground(rays: Array, distance: Array) -> float:
    """Median height above what is seen below along unit rays (n, 3), y down, at radial distances (n,).

    NaN if too few of them look down far enough, or have a distance.
    """
    down = np.arcsin(np.clip(rays[:, 1], -1.0, 1.0))
    used = (down > FARTHEST) & (down < NEAREST) & np.isfinite(distance) & (distance > 0)
    return float(np.median(distance[used] * rays[used, 1])) if int(used.sum()) >= ENOUGH else float("nan")

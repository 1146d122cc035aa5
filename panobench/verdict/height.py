"""The camera's height above what it stands over: a scale that drifts shows as a floor that rises or sinks.

Nothing tells a single camera the scale of what it sees, and where little has texture the scale drifts. But whoever
carries a camera, or drives it, keeps it at about the same height above the ground, on stairs and slopes too.
"""

from __future__ import annotations

import numpy as np

from panobench.types import Estimate
from panobench.verdict.base import Evidence, falling

#: A run of fewer frames says nothing about drift; it is compared in so many parts.
FRAMES, PARTS = 100, 10
#: Largest over smallest height of the parts that every right run may have, and that none has.
RATIO_GOOD, RATIO_BAD = 1.7, 3.0
#: Share of a change in height that must be a climb of the camera itself for the climb to explain it.
EXPLAINED = 0.5
#: Trust does not fall lower: the ground itself may have changed.
LEAST = 0.2


def steady_height(estimate: Estimate) -> Evidence | None:
    """Whether the ground stays below the camera, if the method says its height per frame ("height")."""
    rows = (row for _, row in sorted(estimate.frames.items()))
    heights = np.array([row["height"] for row in rows if "height" in row])
    poses = estimate.trajectory.T_wc
    if len(heights) < FRAMES or len(poses) < FRAMES or estimate.metric:
        return None
    climbed = poses[:, :3, 3] @ -poses[:, :3, 1].mean(axis=0)
    h = np.array([np.median(part) for part in np.array_split(heights, PARTS)])
    z = np.array([np.median(part) for part in np.array_split(climbed, PARTS)])
    high, low = int(h.argmax()), int(h.argmin())
    ratio = float(h[high] / max(h[low], 1e-9))
    if z[high] - z[low] > EXPLAINED * (h[high] - h[low]):
        return Evidence("height", 1.0, "the camera's height above the ground changes as it climbs")
    if ratio <= RATIO_GOOD:
        return Evidence("height", 1.0, "the camera stays at about the same height above the ground")
    return Evidence(
        "height",
        max(falling(ratio, RATIO_GOOD, RATIO_BAD), LEAST),
        f"the camera's height above the ground changes by a factor of {ratio:.1f} without a climb: the scale may drift",
        "use an IMU or two lenses (metres), more pixels (--width), or compare with another method (--check)",
    )

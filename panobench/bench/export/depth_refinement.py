"""Depth of a map put right by the frames: a sweep over a narrow range around it.

A map is made of what few neighbouring frames show; with the final poses, frames far apart tell more. Shells a fixed
ratio apart around the depth at hand, semi-global matching, and a parabola through the least costs.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.photometric.stereo import SweepOptions
from panobench.photometric.sweep import semi_global, winner_takes_all

Float = NDArray[np.float32]

#: Shells on each side of the depth, and the log of the ratio between neighbours.
SHELLS, STEP = 10, 0.008
#: Depth changes where this lowers the mean difference of luma (of 1) by more than that: not where nothing has texture.
GAIN = 0.0005
#: Pixels over which differences are averaged.
WINDOW = 3


def refined(views: PosedPanoramas, k: int, depth: Float) -> Float:
    """(H, W): the radial depth near ``depth`` (H, W; finite) on which the frames agree best, if they agree better."""
    o, numbers = SweepOptions(), np.arange(-SHELLS, SHELLS + 1)
    costs = [views.difference(k, depth * np.float32(np.exp(STEP * i)), WINDOW) for i in numbers]
    volume = np.ascontiguousarray(np.stack(costs, axis=-1), np.float32)
    guide = np.nan_to_num(views.luma[k])
    total = semi_global(volume, guide, np.float32(o.p1), np.float32(o.p2), np.float32(o.edge), True)
    factor, confidence = np.empty_like(depth), np.empty_like(depth)
    winner_takes_all(total, -SHELLS * STEP, STEP, factor, confidence)
    found = np.asarray(cv2.medianBlur(np.ascontiguousarray(depth * factor, np.float32), 5), np.float32)
    better = views.difference(k, depth) - views.difference(k, found) > GAIN
    return np.where(better, found, depth)

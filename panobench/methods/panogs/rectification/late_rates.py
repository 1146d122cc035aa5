"""Rectifying a frame once more: two frames later the camera's motion is known from both sides.

At its own moment a frame's angular velocity is extrapolated from rates between frames, which takes up much of the
poses' noise. By two frames on either side it takes up a third as much.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import so3_log
from panobench.methods.panogs.factor_graph.factors import FactorGraph
from panobench.methods.panogs.fixed_lag.frame_buffer import FrameBuffer
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.rectification.rectify import Rectifier
from panobench.methods.panogs.tracking.tracker import Tracker
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.photometric.pyramid import F32

#: Weights of the mean rates between five frames in the rate at the middle one: the quartic through their positions.
CENTRED = np.array([-1.0, 7.0, 7.0, -1.0]) / 12


@dataclass(frozen=True)
class _Seen:
    """A tracked frame: its image (H, W, 3) as it came, and the radial depth (H, W) it was rectified by."""

    index: int
    time: float
    image: NDArray[np.uint8]
    depth_map: F32


class LateRates:
    """Keeps the last frames as they came."""

    def __init__(self, rectifier: Rectifier, trajectory: AnchoredTrajectory) -> None:
        self.rectifier, self.trajectory = rectifier, trajectory
        self._last: deque[_Seen] = deque(maxlen=len(CENTRED) + 1)

    def add(self, index: int, time: float, image: NDArray[np.uint8], depth_map: F32) -> None:
        """A frame that was tracked and rectified."""
        if self._last and abs(index - self._last[-1].index) != 1:
            self._last.clear()
        self._last.append(_Seen(index, time, image, depth_map))

    def forget(self) -> None:
        """The last frames are not used as they were rectified."""
        self._last.clear()

    def rectified(self) -> tuple[int, NDArray[np.uint8]] | None:
        """The index of the frame two before the newest, and its image (H, W, 3) rectified by what is known now."""
        poses = [self.trajectory.get(seen.index) for seen in self._last]
        known = [T for T in poses if T is not None]
        if len(known) <= len(CENTRED):
            return None
        steps = [np.r_[so3_log(a[:3, :3].T @ b[:3, :3]), b[:3, 3] - a[:3, 3]] for a, b in pairwise(known)]
        middle, times = self._last[len(CENTRED) // 2], np.array([seen.time for seen in self._last])
        motion = CENTRED @ (np.stack(steps) / np.diff(times)[:, None])
        velocity = known[len(CENTRED) // 2][:3, :3].T @ motion[3:]
        return middle.index, self.rectifier.rectified(middle.image, motion[:3], velocity, middle.depth_map)


def renew_image(late: LateRates, tracker: Tracker, mapper: Mapper, buffer: FrameBuffer, graph: FactorGraph) -> None:
    """Replace the image of the frame two before the newest, wherever it waits to be used."""
    found = late.rectified()
    if found is None:
        return
    index, image = found
    mapper.replace_image(index, image)
    buffered = buffer.find(index)
    if buffered is not None:
        levels = tracker.frame_pyramid(image, buffered.visible)
        graph.replace_luma(index, buffer.replace_image(buffered, image, levels))

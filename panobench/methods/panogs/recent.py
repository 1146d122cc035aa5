"""The last frames that moved, at the size on which their poses and depths are worked out together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale
from panobench.types import Frame

#: Working widths of sweeps and of pose refinement.
SWEEP_WIDTH = 256
FINE_WIDTH = 512
#: A frame is remembered if it moved this far from the last remembered one, over the scene's depth.
STEP_MIN = 0.008


@dataclass
class RecentFrame:
    """A tracked frame: its number, image (H, W, 3), luma (h, w) at the sweep's and at the smoother's size, and whether
    the map may see it.
    """

    index: int
    image: NDArray[np.uint8]
    luma: F32
    fine: F32
    mappable: bool = True


class RecentFrames:
    """A ring of at most ``size`` frames, oldest first."""

    def __init__(self, camera: Camera, size: int) -> None:
        self.scale = WorkingScale.of(camera, SWEEP_WIDTH)
        self.fine = WorkingScale.of(camera, FINE_WIDTH)
        self._frames: deque[RecentFrame] = deque(maxlen=size)
        self._last = np.full(3, np.inf)

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: Frame, pyramid: list[F32], position: NDArray[np.float64], depth: float) -> RecentFrame | None:
        """Remember a tracked frame unless it hardly moved; ``depth``: the scene's, in the unit of ``position``."""
        if np.linalg.norm(position - self._last) < STEP_MIN * depth:
            return None
        luma, fine = (pyramid[min(scale.level, len(pyramid) - 1)] for scale in (self.scale, self.fine))
        if luma.shape != self.scale.valid.shape:
            return None
        self._last = position
        self._frames.append(RecentFrame(frame.index, frame.image, luma, fine, frame.mappable))
        return self._frames[-1]

    def clear(self) -> None:
        """What comes does not follow what came."""
        self._frames.clear()
        self._last = np.full(3, np.inf)

    def before(self, delay: int) -> RecentFrame:
        """The frame ``delay`` before the newest."""
        return self._frames[-1 - delay]

    def split(self, delay: int) -> tuple[RecentFrame, list[RecentFrame]] | None:
        """The frame ``delay`` before the newest, or the first after it that may be mapped, and those after that.

        None while there are too few.
        """
        frames = list(self._frames)[-1 - delay :]
        if len(frames) <= delay:
            return None
        first = next((k for k, f in enumerate(frames) if f.mappable), delay)
        return (frames[first], frames[first + 1 :]) if first < delay else None

    def until_mappable(self) -> list[RecentFrame]:
        """All frames up to the last that may be mapped."""
        frames = list(self._frames)
        while frames and not frames[-1].mappable:
            frames.pop()
        return frames

"""The last tracked frames that moved, at the sizes on which their poses and depths are estimated together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.panogs.config import FixedLagOptions
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale
from panobench.types import Frame

#: Working widths of plane sweeps and of pose refinement, pixels.
SWEEP_WIDTH = 256
FINE_WIDTH = 512


@dataclass
class BufferedFrame:
    """A tracked frame: its index, image (H, W, 3) and luma (h, w) at the sweep's and at the fine working size.

    mappable: False for a held-out frame, which the map must never see. visible (H, W): as ``View.visible``.
    """

    index: int
    image: NDArray[np.uint8]
    luma: F32
    fine: F32
    mappable: bool = True
    visible: NDArray[np.bool_] | None = None


class FrameBuffer:
    """A ring of the last frames that moved, oldest first; as many as the lag needs."""

    def __init__(self, camera: Camera, options: FixedLagOptions) -> None:
        self.options = options
        self.sweep_scale = WorkingScale.of(camera, SWEEP_WIDTH)
        self.fine_scale = WorkingScale.of(camera, FINE_WIDTH)
        self._frames: deque[BufferedFrame] = deque(maxlen=options.lag + 1)
        self._last = np.full(3, np.inf)

    def __len__(self) -> int:
        return len(self._frames)

    def add(
        self, frame: Frame, pyramid: list[F32], position: NDArray[np.float64], scene_depth: float
    ) -> BufferedFrame | None:
        """Buffer a tracked frame unless it hardly moved. position (3,) and scene_depth in the unit of the poses."""
        if np.linalg.norm(position - self._last) < self.options.step_min * scene_depth:
            return None
        sweep, fine = (pyramid[min(s.level, len(pyramid) - 1)] for s in (self.sweep_scale, self.fine_scale))
        if sweep.shape != self.sweep_scale.valid.shape:
            return None
        self._last = position
        self._frames.append(BufferedFrame(frame.index, frame.image, sweep, fine, frame.mappable, frame.mask))
        return self._frames[-1]

    def find(self, index: int) -> BufferedFrame | None:
        """The frame of that index in the sequence, if it is here."""
        return next((frame for frame in self._frames if frame.index == index), None)

    def replace_image(self, frame: BufferedFrame, image: NDArray[np.uint8], pyramid: list[F32]) -> F32:
        """Another image (H, W, 3) of a buffered frame, with its luma pyramid; returns its luma at the fine size."""
        sweep, fine = (pyramid[min(s.level, len(pyramid) - 1)] for s in (self.sweep_scale, self.fine_scale))
        frame.image, frame.luma, frame.fine = image, sweep, fine
        return fine

    def clear(self) -> None:
        """The next frame does not follow the buffered ones."""
        self._frames.clear()
        self._last = np.full(3, np.inf)

    def before(self, lag: int) -> BufferedFrame:
        """The frame ``lag`` frames before the newest."""
        return self._frames[-1 - lag]

    def newest(self, count: int) -> list[BufferedFrame]:
        """The last ``count`` frames, or as many as there are, oldest first."""
        return list(self._frames)[-count:]

    def split(self, lag: int) -> tuple[BufferedFrame, list[BufferedFrame]] | None:
        """The frame ``lag`` frames before the newest, or the first after it that may be mapped, and those after that.

        None while there are too few frames.
        """
        frames = list(self._frames)[-1 - lag :]
        if len(frames) <= lag:
            return None
        first = next((k for k, f in enumerate(frames) if f.mappable), lag)
        return (frames[first], frames[first + 1 :]) if first < lag else None

    def until_mappable(self) -> list[BufferedFrame]:
        """All frames up to the last one that may be mapped."""
        frames = list(self._frames)
        while frames and not frames[-1].mappable:
            frames.pop()
        return frames

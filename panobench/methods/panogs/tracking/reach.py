"""Whether the camera can have come to a pose since its last one: rooms that look alike are no reason to jump."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.inertial.prediction import looks_elsewhere

Pose = NDArray[np.float64]
#: A camera that was lost has moved by at most this many of its median steps a frame, and by this much more, in depths.
STEPS, FREE_DEPTHS = 5.0, 0.5


@dataclass
class Reach:
    """steps: distances from frame to frame of the last ``frames`` tracked ones, in the map's unit."""

    frames: int
    steps: deque[float] = field(default_factory=deque)

    def record(self, before: Pose, after: Pose, frames: int) -> None:
        """The camera moved from one pose (4, 4) to another within so many frames."""
        self.steps.append(float(np.linalg.norm(after[:3, 3] - before[:3, 3])) / frames)
        while len(self.steps) > self.frames:
            self.steps.popleft()

    def usual(self, frames: int) -> float:
        """The way of so many frames at the usual speed; infinite while none is known."""
        return frames * float(np.median(self.steps)) if self.steps else np.inf

    def allows(self, before: Pose, after: Pose, frames: int, depth: float, expected: Pose | None = None) -> bool:
        """Whether ``after`` can be reached from ``before`` within so many frames.

        depth: of the scene. expected (4, 4): where an IMU expects the camera; only its rotation counts.
        """
        if looks_elsewhere(after, expected):
            return False
        most = STEPS * self.usual(frames) + FREE_DEPTHS * depth
        return float(np.linalg.norm(after[:3, 3] - before[:3, 3])) <= most

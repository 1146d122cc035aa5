"""Whom a run tells how far it is: a progress bar, a log, or nobody."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from panobench.types import Trajectory


class Observer:
    """Called from the run's own thread, between frames; never counted in the method's time. Does nothing."""

    def stage(self, text: str) -> None:
        """What happens now: "setting up", "tracking", "finishing", "evaluating"."""

    def log(self, line: str) -> None:
        """A line was added to log.txt."""

    def started(self, total: int, truth: Trajectory | None) -> None:
        """Tracking begins; ``truth`` is for showing the error so far."""

    def frame(self, index: int, time: float, T_wc: NDArray[np.float64] | None, latency_s: float) -> None:
        """A frame was given to the method."""

"""The interface through which a run reports its progress."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from panobench.types import Trajectory


class Observer:
    """Is told how far a run is, in the run's thread, between frames; its time never counts. This one does nothing."""

    def stage(self, text: str) -> None:
        """A stage begins: "setting up", "tracking", "finishing", "evaluating" or "writing"."""

    def log(self, line: str) -> None:
        """A line was added to log.txt."""

    def warn(self, text: str) -> None:
        """Something that the user should know while the run goes on."""

    def found(self, dataset: str, what: str) -> None:
        """No dataset was named: the data are ``what``, and read as ``dataset``."""

    def interrupted(self) -> None:
        """The first Ctrl-C: the run stops after this frame and finishes. Called from the signal's handler."""

    def compiling(self, done: int, total: int) -> None:
        """So many of the kernels that are not compiled yet are now; first none. Nothing is timed yet."""

    def started(self, total: int, truth: Trajectory | None) -> None:
        """Tracking begins; ``truth`` is for showing the error so far."""

    def frame(self, index: int, time: float, T_wc: NDArray[np.float64] | None, latency_s: float) -> None:
        """A frame was given to the method."""

"""The depth-estimator contract: frames go in until it has a depth of the first one it wants to start from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from panobench.types import DepthEstimate, Frame

if TYPE_CHECKING:
    from panobench.cameras.base import Camera


class DepthEstimator(ABC):
    """Estimates the radial depth of one of the first frames.

    ``argument`` is what followed the colon in `--depth name:ARGUMENT`.
    """

    def __init__(self, argument: str = "") -> None:
        self.argument = argument

    @abstractmethod
    def start(self, camera: Camera, seed: int = 0) -> None:
        """Called once before the first frame."""

    @abstractmethod
    def add(self, frame: Frame) -> DepthEstimate | None:
        """Offer the next frame; None means "more frames, please"."""

    def finish(self) -> DepthEstimate | None:
        """No more frames will come: the best it can say, or None if it never saw one."""
        return None

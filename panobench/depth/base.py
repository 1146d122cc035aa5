"""The contract of depth estimators: they take frames until they can give the depth of one of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from panobench.types import DepthEstimate, Frame

if TYPE_CHECKING:
    from panobench.cameras.base import Camera


class DepthEstimator(ABC):
    """Estimates the radial depth of one of the first frames.

    ``argument`` is what follows the colon in `--depth name:ARGUMENT`.
    """

    def __init__(self, argument: str = "") -> None:
        self.argument = argument

    @abstractmethod
    def start(self, camera: Camera, seed: int = 0) -> None:
        """Called once, before the first frame."""

    @abstractmethod
    def add(self, frame: Frame) -> DepthEstimate | None:
        """Take the next frame. Returns None if more frames are needed."""

    def finish(self) -> DepthEstimate | None:
        """Called when there are no more frames: the best estimate so far, or None without any frame."""
        return None

"""What whoever reads a video needs of it, whether its frames come from one stream or from two."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.video.index import FrameIndex
from panobench.video.orientation import Orientation


class Recording(Protocol):
    """Frames by number; see ``VideoReader``."""

    path: Path
    times: NDArray[np.float64]
    width: int
    height: int
    index: FrameIndex
    orientation: Orientation
    side_data: dict[str, bytes]

    def __len__(self) -> int: ...

    @property
    def rate(self) -> float:
        """Frames per second, the usual ones."""

    @property
    def missing(self) -> list[int]:
        """Frames that cannot be decoded, as far as they were read."""

    @property
    def flawed(self) -> list[int]:
        """Frames that the decoder patched up."""

    def files(self) -> list[Path]:
        """The files read."""

    def read(self, index: int, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """Frame ``index`` as RGB (H, W, 3), ``size`` (width, height) pixels."""

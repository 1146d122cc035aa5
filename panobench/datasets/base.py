"""The dataset contract: a ``Dataset`` lists sequences and opens them; a ``FrameSequence`` hands out frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.types import Frame, Imu, NovelView, Trajectory


class FrameSequence(ABC):
    """Images of one camera in time order, with whatever truth the dataset has.

    Opening one checks all that can be checked without decoding images (files exist, times increase,
    ground truth parses); decoding a frame checks its size. Raises DatasetError naming file and line or frame.
    """

    name: str
    dataset: str
    camera: Camera
    times: NDArray[np.float64]  # (N,) seconds, strictly increasing

    def __len__(self) -> int:
        return len(self.times)

    @abstractmethod
    def image(self, index: int) -> NDArray[np.uint8]:
        """RGB (H, W, 3) of ``self.camera``'s size. Raises DatasetError for a broken or odd-sized image."""

    def frame_name(self, index: int) -> str:
        """The image's name in the dataset, for messages."""
        return f"{index:06d}"

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Radial depth (H, W), metres, NaN unknown, at the camera's size; None if the dataset has none here."""
        return None

    @property
    def groundtruth(self) -> Trajectory | None:
        """True camera-to-world poses at some or all of ``times`` (the times match exactly), or None."""
        return None

    @property
    def imu(self) -> Imu | None:
        """Inertial samples, and where the camera sits in their axes, or None."""
        return None

    def novel_views(self) -> list[NovelView]:
        """Views apart from the trajectory with true poses."""
        return []

    def rendered_by(self, camera: Camera, R_target_source: NDArray[np.float64]) -> FrameSequence | None:
        """For generators: the sequence rendered by another camera at the same place, None for recorded images.

        ``R_target_source`` (3, 3) takes vectors from this camera's axes to the other's.
        """
        return None

    def remarks(self) -> list[str]:
        """What one must know of the input to judge a result, one line each: frames that could not be decoded, times or
        a layout that were assumed. Asked for when a run begins and when it ends. Wrappers pass their source's on.
        """
        return []

    def provenance(self) -> dict[str, Any]:
        """For run.json: root, files, checksums, generator parameters."""
        return {}

    def frames(self) -> Iterator[Frame]:
        for i, t in enumerate(self.times):
            yield Frame(i, float(t), self.image(i), name=self.frame_name(i))


#: What ``FrameSequence`` was called in contract 1.0; kept for plugins written for it.
Sequence = FrameSequence


class Dataset(ABC):
    """Opens sequences below ``root`` (None for generators)."""

    name: ClassVar[str]

    def __init__(self, root: Path | None = None) -> None:
        self.root = root

    @abstractmethod
    def sequences(self) -> list[str]:
        """Names that ``open`` takes. Raises DatasetError when nothing usable is at root."""

    @abstractmethod
    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        """Open one sequence (None: the only one or the first), frames resized to ``width`` by an area filter.

        Raises UnknownNameError for a name it does not have, DatasetError for data it cannot use.
        """

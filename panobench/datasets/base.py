"""The dataset contract: a ``Dataset`` lists and opens sequences; a ``FrameSequence`` provides their frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig import Rig
from panobench.datasets.given import Given
from panobench.types import Frame, Imu, NovelView, Trajectory


class FrameSequence(ABC):
    """Images of one camera in time order, with whatever ground truth the dataset has.

    Opening one checks everything that needs no image decoded: files exist, times increase, ground truth parses.
    Decoding a frame checks its size. A DatasetError names file and line or frame.
    """

    name: str
    dataset: str
    camera: Camera
    times: NDArray[np.float64]  # (N,) seconds, strictly increasing

    def __len__(self) -> int:
        return len(self.times)

    @property
    def start_time(self) -> float:
        """Seconds on the recorder's clock at which ``times`` is 0; 0.0 where they are on it, or it is not known."""
        return 0.0

    @abstractmethod
    def image(self, index: int) -> NDArray[np.uint8]:
        """RGB (H, W, 3) of ``self.camera``'s size. Raises DatasetError for a damaged image or one of another size."""

    def frame_name(self, index: int) -> str:
        """The image's name in the dataset, for messages."""
        return f"{index:06d}"

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Radial depth (H, W) at the camera's size, metres, NaN unknown; None if the frame has none."""
        return None

    @property
    def rig(self) -> Rig | None:
        """Several lenses with a centre each, whose pictures ``lens_images`` has; its axes are ``camera``'s.

        ``camera`` and ``image`` are then what one centre would have seen: the pictures stitched.
        """
        return None

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        """One RGB picture (H, W, 3) for each lens of the ``rig``, of its camera's size; () without a rig."""
        return ()

    def frame_mask(self, index: int) -> NDArray[np.bool_] | None:
        """(H, W): where this frame shows the scene, besides the camera's mask; None: wherever the camera sees."""
        return None

    @property
    def enlargement(self) -> float:
        """How many pixels of a frame lie, along one axis, in one pixel of what was recorded; 1.0: no more than one.

        Errors in pixels count for so much less, since nothing in the picture says where within its own pixel it lies.
        """
        return 1.0

    @property
    def groundtruth(self) -> Trajectory | None:
        """True camera-to-world poses at some or all of ``times``, whose times match exactly; or None."""
        return None

    @property
    def groundtruth_scaled(self) -> bool:
        """Whether the ground truth's unit is the metre, and not that of a reconstruction from images."""
        return True

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        """The direction against gravity (3,), a unit vector in the ground truth's world; None where it is not known."""
        return None

    @property
    def recorded_truth(self) -> Trajectory | None:
        """The ground truth as recorded, camera-to-world, with stamps of its own; None where it has those of frames."""
        return None

    @property
    def imu(self) -> Imu | None:
        """Inertial samples and the camera's pose in their axes, or None."""
        return None

    def novel_views(self) -> list[NovelView]:
        """Views with true poses away from the trajectory."""
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
        """Where the data come from, for run.json: root, files, checksums, parameters of a generator."""
        return {}

    def frames(self) -> Iterator[Frame]:
        for i, t in enumerate(self.times):
            yield Frame(i, float(t), self.image(i), name=self.frame_name(i))


#: What ``FrameSequence`` was called in contract 1.0; kept for plugins written for it.
Sequence = FrameSequence


class Dataset(ABC):
    """A dataset below ``root``; None for a generator.

    takes: names of the options in ``Given`` that it has a use for; ``open_dataset`` puts what was given into ``given``.
    """

    name: ClassVar[str]
    takes: ClassVar[frozenset[str]] = frozenset()
    given: Given = Given()

    def __init__(self, root: Path | None = None) -> None:
        self.root = root

    @abstractmethod
    def sequences(self) -> list[str]:
        """Names that ``open`` takes. Raises DatasetError when there is nothing usable at root."""

    @abstractmethod
    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        """Open one sequence (None: the first), with frames resized to ``width`` by an area filter (None: as stored).

        Raises UnknownNameError for a name that it does not have, DatasetError for data that it cannot use.
        """

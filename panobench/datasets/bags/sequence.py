"""One bag as a sequence: images on demand, and what the pass over it found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.bags.contents import Contents
from panobench.datasets.bags.files import BagFile
from panobench.datasets.bags.images import decode_image_message
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.checksums import files_provenance
from panobench.datasets.files.images import resize_image
from panobench.datasets.files.truth import truth_at_frames
from panobench.datasets.formats.image_sequence import scaled_camera
from panobench.types import Imu, Trajectory


@dataclass(frozen=True)
class BagSource:
    """What a ``BagSequence`` is made of.

    native: camera of the stored images. recorded: true camera poses with their own stamps. inputs: further files read.
    up: against gravity in the world of these poses, where that is known. notes: for run.json.
    """

    dataset: str
    name: str
    bag: BagFile
    topic: str
    contents: Contents
    native: Camera
    imu: Imu | None = None
    recorded: Trajectory | None = None
    up: tuple[float, float, float] | None = None
    inputs: tuple[Path, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


class BagSequence(FrameSequence):
    """Images of one topic, decoded on demand and resized to the camera's width. Reading is thread-safe."""

    def __init__(self, source: BagSource, width: int | None) -> None:
        self.source = source
        self.name, self.dataset, self.times = source.name, source.dataset, source.contents.times
        self.camera = scaled_camera(source.native, width)
        self._truth = None if source.recorded is None else truth_at_frames(source.recorded, self.times)

    def image(self, index: int) -> NDArray[np.uint8]:
        index = range(len(self))[index]
        bag, contents = self.source.bag, self.source.contents
        message = bag.parse(bag.at(self.source.topic, contents.places[index]), index)
        rgb = decode_image_message(message, bag.path, index, contents.bits)
        return resize_image(rgb, self.camera.width, self.camera.height)

    @property
    def enlargement(self) -> float:
        return max(1.0, self.camera.width / self.source.native.width)

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._truth

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self.source.recorded

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return None if self.source.up is None else np.array(self.source.up)

    @property
    def imu(self) -> Imu | None:
        return self.source.imu

    def remarks(self) -> list[str]:
        return [*self.source.contents.remarks(), *self.source.remarks]

    def provenance(self) -> dict[str, Any]:
        s = self.source
        return {
            "dataset": s.dataset,
            "sequence": s.name,
            "root": str(s.bag.path),
            "native_size": [s.native.width, s.native.height],
            "bag": s.bag.kind,
            "image_topic": s.topic,
            **s.notes,
            "groundtruth_messages_out_of_order": s.contents.truth.late,
            **files_provenance([*s.inputs, *s.bag.files]),
        }

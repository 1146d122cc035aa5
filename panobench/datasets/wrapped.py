"""What sequences made from another sequence pass on of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.types import Imu, NovelView, Trajectory


class WrappedSequence(FrameSequence):
    """``source`` in another way. What is known of its recording is passed on unless a subclass says otherwise.

    Whatever depends on how the frames look (images, depth, lenses, masks of single frames) is for the subclass to say.
    """

    source: FrameSequence

    @property
    def start_time(self) -> float:
        return self.source.start_time

    def frame_name(self, index: int) -> str:
        return self.source.frame_name(index)

    @property
    def enlargement(self) -> float:
        return self.source.enlargement

    @property
    def groundtruth(self) -> Trajectory | None:
        return self.source.groundtruth

    @property
    def groundtruth_scaled(self) -> bool:
        return self.source.groundtruth_scaled

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self.source.recorded_truth

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return self.source.world_up

    @property
    def imu(self) -> Imu | None:
        return self.source.imu

    def novel_views(self) -> list[NovelView]:
        return self.source.novel_views()

    def remarks(self) -> list[str]:
        return self.source.remarks()

    def provenance(self) -> dict[str, Any]:
        return self.source.provenance()

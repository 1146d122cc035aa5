"""Any dataset's sequences with a disturbed stream, by name: ``rooms/room1+operator-15:noise=0.03``.

Behind "+" stand the parts of a simulated recording (``panobench.capture``), behind ":" disturbances of the images.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.synthetic.disturb import BARE, Disturbances, Disturber
from panobench.datasets.wrapped import WrappedSequence
from panobench.errors import UsageError
from panobench.types import Imu, Trajectory

#: Raised when the same name gives other images.
DISTURBANCE_VERSION = 1
#: Parts of recordings that are worth a look.
EXAMPLES = (
    "operator-15",
    "car-25",
    "walkers-3",
    "rolling-15ms+turn-200",
    "blur-10ms+turn-200",
    "stitch-41mm+lenses-0.3",
    "gait+levelled+operator-15",
    "h264-0.2",
    "operator-15+walkers-3+rolling-15ms+stitch-41mm+lenses+gait+h264",
)


class DisturbedSequence(WrappedSequence):
    """``source`` with its images disturbed; truth is that of the turned camera, novel views stay as they are."""

    def __init__(self, source: FrameSequence, chosen: Disturbances, name: str) -> None:
        self.source = source
        self.name, self.dataset, self.camera, self.times = name, "disturbed", source.camera, source.times
        self._disturb = Disturber(chosen, source.camera, len(source))

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._disturb(self.source.image(index), index)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Of the scene, as if nothing were before the camera; nearest column when the camera is turned."""
        depth = self.source.depth(index)
        return None if depth is None else np.roll(depth, -round(self._disturb.shift(index)), axis=1)

    @cached_property
    def _groundtruth(self) -> Trajectory | None:
        truth = self.source.groundtruth
        if truth is None or not self._disturb.chosen.yaw:
            return truth
        index = np.searchsorted(self.times, truth.times)
        turned = [T @ self._disturb.rotation(int(i)) for i, T in zip(index, truth.T_wc)]
        return Trajectory(truth.times, np.stack(turned))

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._groundtruth

    @property
    def recorded_truth(self) -> Trajectory | None:
        """The source's; none when the camera is turned, for the turn is known at the frames alone."""
        return None if self._disturb.chosen.yaw else self.source.recorded_truth

    @property
    def imu(self) -> Imu | None:
        """The source's; none when the camera is turned, for the body does not turn with it."""
        return None if self._disturb.chosen.yaw else self.source.imu

    def provenance(self) -> dict[str, Any]:
        about = {"version": DISTURBANCE_VERSION, "seed": self._disturb.seed, **self._disturb.chosen.to_dict()}
        return {**self.source.provenance(), "source": self.source.dataset, "disturbances": about}


class DisturbedDataset(Dataset):
    """Sequences of other datasets; ``root`` is handed to the one a name asks for, unless it needs none."""

    name: ClassVar[str] = "disturbed"

    def sequences(self) -> list[str]:
        """Examples on one room: each disturbance, and parts of a recording.

        Any DATASET/SEQUENCE can stand before them, and several after it.
        """
        return [f"rooms/room1:{name}" for name in BARE] + [f"rooms/room1+{parts}" for parts in EXAMPLES]

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        """Open [DATASET/]SEQUENCE[+PART[-NUMBER]]...[:DISTURBANCE[=NUMBER]]...; the dataset is ``rooms`` by default.

        Raises UnknownNameError and UsageError for parts and disturbances that do not exist, and what the data raise.
        """
        from panobench.capture.parts import split_name
        from panobench.datasets.open import open_sequence
        from panobench.plugins import registry
        from panobench.rooms.options import VARIANTS
        from panobench.specs import DatasetSpec

        name = sequence or self.sequences()[0]
        place, *texts = name.split(":")
        dataset, slash, inner = place.partition("/")
        if not slash:
            dataset, inner = "rooms", place
        if dataset == self.name:
            raise UsageError(f"sequence '{name}': name a dataset that is not disturbed yet")
        chosen = Disturbances.parse(texts)
        inner, parts = split_name(inner, VARIANTS if dataset == "rooms" else ())
        root = self.root if registry().get(DatasetSpec, dataset).needs_root else None
        source = open_sequence(dataset, inner or None, root, width)
        if parts:
            from panobench.capture.sequence import CapturedSequence

            source = CapturedSequence(source, parts, name)
            if not texts:
                return source
        return DisturbedSequence(source, chosen, name)

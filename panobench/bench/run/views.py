"""What the runner puts between a dataset and a method: the chosen frames, without ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.footprint import enlarged_remark
from panobench.cameras.rig import Rig, seen_in_panorama
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.truth import truth_remarks
from panobench.errors import DatasetError
from panobench.masks.frame_masks import FrameMasks
from panobench.types import Frame, Imu, NovelView, Trajectory


class ChosenFrames(FrameSequence):
    """Each ``every``-th frame of a sequence, at most ``max_frames``, renumbered from 0."""

    def __init__(self, inner: FrameSequence, every: int = 1, max_frames: int | None = None) -> None:
        if len(inner) == 0:
            raise DatasetError(f"sequence '{inner.name}' has no frames")
        self._inner = inner
        self._truth: tuple[Trajectory | None] | None = None
        self._recorded: Trajectory | None = None
        self._index = np.arange(0, len(inner), every)[:max_frames]
        self.name, self.dataset, self.camera = inner.name, inner.dataset, inner.camera
        self.times = np.asarray(inner.times, dtype=np.float64)[self._index]
        self._hidden: NDArray[np.bool_] | None = None
        self._rig: tuple[Rig | None] | None = None
        self._frame_masks: Mapping[int, NDArray[np.bool_]] = {}
        self._read_masks = FrameMasks()
        if not (np.isfinite(self.times).all() and (np.diff(self.times) > 0).all()):
            raise DatasetError(f"sequence '{inner.name}': the times are not finite and increasing")

    @property
    def whole(self) -> int:
        """How many frames the whole sequence has."""
        return len(self._inner)

    def hide(self, pixels: NDArray[np.bool_]) -> None:
        """Take ``pixels`` (H, W) out of the camera's view, for whoever reads the frames from now on."""
        if (self.camera.valid_mask() & pixels).any():
            self.camera = self.camera.with_mask(self.camera.valid_mask() & ~pixels)
            self._hidden = pixels if self._hidden is None else self._hidden | pixels
            self._rig = None

    @property
    def rig(self) -> Rig | None:
        """The source's; what is hidden is hidden from its lenses, too."""
        if self._rig is None:
            rig = self._inner.rig
            if rig is not None and self._hidden is not None:
                rig = rig.with_masks(seen_in_panorama(rig, self.camera, ~self._hidden))
            self._rig = (rig,)
        return self._rig[0]

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        return self._inner.lens_images(self.original(index))

    def hide_in_frames(self, masks: Mapping[int, NDArray[np.bool_]]) -> None:
        """Frames by index show the scene only in these pixels (H, W), besides what their source says."""
        self._frame_masks, self._read_masks = masks, FrameMasks()

    def frame_mask(self, index: int) -> NDArray[np.bool_] | None:
        """What the source says and ``hide_in_frames`` said; the source is asked once."""
        if index not in self._read_masks:
            mask = self._combined_mask(index)
            if mask is None:
                return None
            self._read_masks.put(index, mask)
        return self._read_masks[index]

    def frame_masks(self) -> FrameMasks:
        """The masks of all frames that have one."""
        for index in range(len(self)):
            self.frame_mask(index)
        return self._read_masks

    def _combined_mask(self, index: int) -> NDArray[np.bool_] | None:
        own, found = self._inner.frame_mask(self.original(index)), self._frame_masks.get(index)
        return own if found is None else found if own is None else own & found

    def original(self, index: int) -> int:
        """The frame's number in the whole sequence."""
        return int(self._index[index])

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._inner.image(self.original(index))

    @property
    def enlargement(self) -> float:
        return self._inner.enlargement

    @property
    def start_time(self) -> float:
        return self._inner.start_time

    def frame_name(self, index: int) -> str:
        return self._inner.frame_name(self.original(index))

    def depth(self, index: int) -> NDArray[np.float32] | None:
        return self._inner.depth(self.original(index))

    def with_truth(self, truth: Trajectory | None, recorded: Trajectory | None) -> ChosenFrames:
        """The same frames with another ground truth."""
        changed = copy(self)
        changed._truth, changed._recorded = (truth,), recorded
        return changed

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self._inner.recorded_truth if self._recorded is None else self._recorded

    @property
    def groundtruth(self) -> Trajectory | None:
        truth = self._inner.groundtruth if self._truth is None else self._truth[0]
        if truth is None:
            return None
        truth = truth.select(np.flatnonzero(np.isin(truth.times, self.times)))
        return truth if len(truth) else None

    @property
    def groundtruth_scaled(self) -> bool:
        return self._inner.groundtruth_scaled

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return self._inner.world_up

    @property
    def imu(self) -> Imu | None:
        return self._inner.imu

    def novel_views(self) -> list[NovelView]:
        return self._inner.novel_views()

    def remarks(self) -> list[str]:
        return [*self._inner.remarks(), *enlarged_remark(self.enlargement, self.camera), *truth_remarks(self)]

    def provenance(self) -> dict[str, Any]:
        return self._inner.provenance()


def held_out(n: int, holdout: int) -> list[int]:
    """Indices of the frames that must not be mapped: each ``holdout``-th, never the first (0: none)."""
    return list(range(holdout - 1, n, holdout)) if holdout else []


class FrameReader:
    """Reads frames for a method: checks them against the camera, copies the image, and blackens what the mask hides.

    What a mask hides, such as a lens's rim or the operator, cannot change a result then. ``lenses``: frames carry the
    pictures of the rig's lenses, too.
    """

    def __init__(self, sequence: FrameSequence, lenses: bool = False) -> None:
        self._sequence = sequence
        self._rig = sequence.rig if lenses else None
        mask = sequence.camera.mask
        self._hidden = None if mask is None else ~mask

    def __call__(self, index: int, mappable: bool = True, depth: NDArray[np.float32] | None = None) -> Frame:
        """The frame at ``index``. Raises DatasetError naming the frame."""
        sequence = self._sequence
        image = sequence.image(index)
        expected = (sequence.camera.height, sequence.camera.width, 3)
        if image.shape != expected or image.dtype != np.uint8:
            raise DatasetError(
                f"the image is {image.shape} {image.dtype}, expected {expected} uint8",
                frame=sequence.frame_name(index),
            )
        image = image.copy()
        if self._hidden is not None:
            image[self._hidden] = 0
        mask = sequence.frame_mask(index)
        if mask is not None:
            image[~mask] = 0
        lenses = self._lenses(index, mask)
        return Frame(
            index, float(sequence.times[index]), image, mappable, depth, sequence.frame_name(index), mask, lenses
        )

    def _lenses(self, index: int, mask: NDArray[np.bool_] | None) -> tuple[NDArray[np.uint8], ...]:
        rig, sequence = self._rig, self._sequence
        if rig is None:
            return ()
        pictures = tuple(picture.copy() for picture in sequence.lens_images(index))
        shapes = [(lens.camera.height, lens.camera.width, 3) for lens in rig.lenses]
        if [p.shape for p in pictures] != shapes or any(p.dtype != np.uint8 for p in pictures):
            raise DatasetError(
                f"the lenses' pictures are {[p.shape for p in pictures]}, expected {shapes} uint8",
                frame=sequence.frame_name(index),
            )
        if mask is not None:
            rig = rig.with_masks(seen_in_panorama(rig, sequence.camera, mask))
        for picture, lens in zip(pictures, rig.lenses):
            picture[~lens.camera.valid_mask()] = 0
        return pictures


class MethodSequence(FrameSequence):
    """The sequence as a batch method gets it, without ground truth: only a function reaches the original."""

    def __init__(
        self,
        sequence: FrameSequence,
        holdout: frozenset[int] = frozenset(),
        imu: Imu | None = None,
        rig: Rig | None = None,
    ) -> None:
        self.name, self.dataset, self.camera = sequence.name, sequence.dataset, sequence.camera
        self.times = sequence.times.copy()
        self._imu, self._rig = imu, rig
        reader = FrameReader(sequence, lenses=rig is not None)
        self._read: Callable[[int], Frame] = lambda index: reader(index, index not in holdout)

    def image(self, index: int) -> NDArray[np.uint8]:
        return self._read(index).image

    def frame_name(self, index: int) -> str:
        return f"{index:06d}"

    @property
    def imu(self) -> Imu | None:
        return self._imu

    @property
    def rig(self) -> Rig | None:
        return self._rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        return self._read(index).lenses

    def frames(self) -> Iterator[Frame]:
        for index in range(len(self)):
            yield self._read(index)

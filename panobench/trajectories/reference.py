"""Any trajectory as the ground truth of a sequence: `panobench run --groundtruth FILE`, `import --against FILE`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig import Rig
from panobench.cameras.views import rotated_poses
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.checksums import known_sha256
from panobench.datasets.files.trajectory_match import nearest
from panobench.datasets.files.truth import MAX_GAP_S, truth_at_frames
from panobench.datasets.wrapped import WrappedSequence
from panobench.errors import InputError, UsageError
from panobench.trajectories.matching import Frames, place
from panobench.trajectories.posed import PoseList
from panobench.trajectories.reading import read_poses
from panobench.types import NovelView, Trajectory

SCALES = ("metres", "none")


@dataclass(frozen=True)
class Reference:
    """True poses of (some) frames. scaled: in metres; otherwise errors are shares of the path. recorded: the poses with
    stamps of their own, of which the others were made.
    """

    path: Path
    trajectory: Trajectory
    scaled: bool
    remarks: tuple[str, ...] = ()
    recorded: Trajectory | None = None


def read_reference(
    path: Path,
    frames: Frames,
    *,
    scale: str | None = None,
    unit: str | None = None,
    inverse: bool = False,
    any_clock: bool = False,
) -> Reference:
    """Poses at the frames' times: those of the image name or frame number, by time interpolated to the frames.

    scale: "metres", "none" or None for what the format says. unit: what its times count; see ``read_poses``.
    any_clock: its times need not be those of the frames. Raises UsageError, DatasetError or InputError.
    """
    found = read_poses(path, unit=unit)
    if inverse:
        found = found.inverted()
    scaled = scaled_as(scale, found)
    if found.times is None:
        placed = place(found, frames, path)
        return Reference(path, placed.trajectory, scaled, placed.remarks)
    found = replace(found, times=found.times + frames.clock_shift(found.times))
    recorded = found.trajectory()
    truth = at_times(recorded, frames.times)
    if len(truth) < 0.5 * min(len(found), len(frames)) and not any_clock:
        place(found, frames, path)  # says what the times may be
    if not len(truth) and not any_clock:
        raise InputError(f"no frame lies between two of its poses within {MAX_GAP_S:g} s", path)
    return Reference(path, truth, scaled, recorded=recorded)


def scaled_as(scale: str | None, found: PoseList) -> bool:
    """Whether poses are in metres: as said, or as the format knows. Raises UsageError for another word."""
    if scale not in (None, *SCALES):
        raise UsageError(f"--groundtruth-scale {scale}: expected {' or '.join(SCALES)}")
    return found.scaled if scale is None else scale == "metres"


def at_times(trajectory: Trajectory, times: NDArray[np.float64]) -> Trajectory:
    """Poses at those of ``times`` that have one, as ground truth is brought to frames everywhere; may be empty."""
    return truth_at_frames(trajectory, times) or trajectory.select([])


class ReferencedSequence(WrappedSequence):
    """``inner`` with another ground truth."""

    def __init__(self, inner: FrameSequence, reference: Reference) -> None:
        self.source, self._reference = inner, reference
        self.name, self.dataset, self.camera, self.times = inner.name, inner.dataset, inner.camera, inner.times

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.source.image(index)

    @property
    def rig(self) -> Rig | None:
        return self.source.rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        return self.source.lens_images(index)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        return self.source.depth(index)

    def frame_mask(self, index: int) -> NDArray[np.bool_] | None:
        return self.source.frame_mask(index)

    @property
    def groundtruth(self) -> Trajectory | None:
        truth = self._reference.trajectory
        return truth if len(truth) else None

    @property
    def recorded_truth(self) -> Trajectory | None:
        return self._reference.recorded

    @property
    def groundtruth_scaled(self) -> bool:
        return self._reference.scaled

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        """None: the reference has a world of its own."""
        return None

    def novel_views(self) -> list[NovelView]:
        """None: their poses are of the dataset's own world."""
        return []

    def rendered_by(self, camera: Camera, R_target_source: NDArray[np.float64]) -> FrameSequence | None:
        inner = self.source.rendered_by(camera, R_target_source)
        if inner is None:
            return None

        def turned(poses: Trajectory) -> Trajectory:
            return Trajectory(poses.times, rotated_poses(poses.T_wc, R_target_source))

        about, recorded = self._reference, self._reference.recorded
        moved = replace(
            about, trajectory=turned(about.trajectory), recorded=None if recorded is None else turned(recorded)
        )
        return ReferencedSequence(inner, moved)

    def remarks(self) -> list[str]:
        return [*self.source.remarks(), *self._reference.remarks]

    def provenance(self) -> dict[str, Any]:
        path = self._reference.path
        about = {"file": path.name, "scaled": self._reference.scaled}
        if path.is_file():
            about["sha256"] = known_sha256(path)
        return {**self.source.provenance(), "groundtruth": about}


class PathAlone(FrameSequence):
    """The frames that two trajectories have in common to be judged by; there are no images.

    Frames are the reference's poses. Where it has many more than ``judged`` (motion capture), they are the poses of
    ``judged``, and as many more as it leaves out of the reference's span.
    """

    def __init__(self, path: Path, reference: PoseList, judged: PoseList, camera: Camera, scaled: bool) -> None:
        self.path, self.camera, self._scaled = path, camera, scaled
        self.name, self.dataset = path.stem, "path"
        self._names: tuple[str, ...] | None = None
        if reference.key != judged.key:
            raise UsageError(
                f"{path.name} has poses by {reference.key}, the other trajectory by {judged.key}: name the data set "
                "whose frames they are with --dataset and --root"
            )
        if reference.times is None:
            order = np.arange(len(reference)) if reference.numbers is None else np.argsort(reference.numbers)
            self.times = np.arange(len(reference), dtype=np.float64)
            self._truth = Trajectory(self.times, reference.T_wc[order])
            self._names = reference.names
            self._numbers = None if reference.numbers is None else reference.numbers[order]
            return
        assert judged.times is not None
        self._numbers = None
        self.times = _frame_times(reference.times, judged.times)
        self._truth = at_times(reference.trajectory(), self.times)

    def frames_to_match(self) -> Frames:
        """What poses are placed by."""
        return Frames(self.times, self._names, self._numbers, len(self))

    def image(self, index: int) -> NDArray[np.uint8]:
        raise InputError("a trajectory has no images", self.path)

    def frame_name(self, index: int) -> str:
        return f"{index:06d}" if self._names is None else self._names[index]

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._truth

    @property
    def groundtruth_scaled(self) -> bool:
        return self._scaled

    def provenance(self) -> dict[str, Any]:
        about = {"root": str(self.path)}
        return {**about, "sha256": known_sha256(self.path)} if self.path.is_file() else about


def _frame_times(reference: NDArray[np.float64], judged: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(reference) < 2 or len(judged) < 2:
        return reference
    step = float(np.median(np.diff(judged)))
    if float(np.median(np.diff(reference))) >= 0.75 * step:
        return reference
    own = judged[(judged >= reference[0]) & (judged <= reference[-1])]
    if len(own) < 0.5 * len(judged):  # of another clock or unit: placing them says so
        return reference
    # one time a step that no judged pose is near
    grid = np.arange(reference[0], reference[-1], step)
    left_out = grid[np.abs(own[nearest(own, grid)] - grid) > step]
    return np.unique(np.concatenate([own, left_out]))

"""The owner of all poses: tracked frames anchored to keyframes, and the one operation that corrects them.

A frame's pose is stored relative to the keyframe it was tracked against, so it follows that keyframe's refinement.
Corrections (fixed-lag smoothing, bundle-adjustment factors, revisits) go through ``correct``. A correction of the
world, not of poses within it, also moves what is expressed in the world: the map, the tracker, the relocaliser.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, invert_pose, renormalise
from panobench.methods.splatting.views import View

Pose = NDArray[np.float64]


@dataclass(frozen=True)
class Correction:
    """New poses T_wc (4, 4) by frame index.

    moves_world: the map goes along, and so do the frames tracked after the first corrected one. stretch: by frame
    index, the factor by which distances around it have grown; the Gaussians of a keyframe grow with it.
    """

    poses: dict[int, Pose]
    moves_world: bool = False
    stretch: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class WorldMotion:
    """How a correction moved the world.

    keyframes: the motion (old world to new world) around each keyframe, in their order. newest (4, 4): around the frame
    tracked last.
    """

    keyframes: list[Sim3]
    newest: Pose


class WorldFollower(Protocol):
    """Whoever holds something expressed in the world."""

    def world_moved(self, motion: WorldMotion) -> None:
        """Move it along."""


@dataclass
class TrackedFrame:
    """time: seconds. relative (4, 4): the frame's pose in the axes of its anchor."""

    time: float
    anchor: View
    relative: Pose

    @property
    def T_wc(self) -> Pose:
        return renormalise(self.anchor.T_wc @ self.relative)


@dataclass
class AnchoredTrajectory:
    """Poses by frame index, in the order of tracking.

    keyframes: in the order they were made. frames: other views that the map is fitted to; their own T_wc is what
    mapping refines. followers: see ``WorldMotion``.
    """

    keyframes: list[View] = field(default_factory=list)
    frames: list[View] = field(default_factory=list)
    followers: list[WorldFollower] = field(default_factory=list)
    _tracked: dict[int, TrackedFrame] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self._tracked)

    def __iter__(self) -> Iterator[int]:
        return iter(self._tracked)

    def __contains__(self, index: int) -> bool:
        return index in self._tracked

    def __getitem__(self, index: int) -> Pose:
        """T_wc (4, 4) of a tracked frame."""
        return self._tracked[index].T_wc

    def get(self, index: int) -> Pose | None:
        """T_wc (4, 4) of a frame, None if it has none."""
        frame = self._tracked.get(index)
        return None if frame is None else frame.T_wc

    def time(self, index: int) -> float:
        """Seconds."""
        return self._tracked[index].time

    def relative(self, reference: int, frames: Sequence[int]) -> Pose:
        """T_fr (F, 4, 4): the reference's axes in those of each frame."""
        T_wr = self[reference]
        return np.stack([invert_pose(self[i]) @ T_wr for i in frames])

    # -- recording ---------------------------------------------------------------------------------------------------

    def add(self, index: int, time: float, T_wc: Pose, anchor: View) -> None:
        """A tracked frame, anchored to a keyframe."""
        self._tracked[index] = TrackedFrame(time, anchor, invert_pose(anchor.T_wc) @ T_wc)

    def add_keyframe(self, view: View, time: float | None = None) -> None:
        """The frame is a keyframe: its own anchor. time: needed if the frame was not added before."""
        if time is None:
            time = self._tracked[view.index].time
        self.keyframes.append(view)
        self._tracked[view.index] = TrackedFrame(time, view, np.eye(4))

    def pop(self, index: int) -> TrackedFrame | None:
        """Take a frame out; None if it is not there."""
        return self._tracked.pop(index, None)

    def restore(self, index: int, frame: TrackedFrame) -> None:
        """Put back what ``pop`` took out."""
        self._tracked[index] = frame

    def adopt(self, other: AnchoredTrajectory, motion: Sim3) -> list[int]:
        """Take over all poses of another trajectory, of whose world ``motion`` is the motion into this one.

        Where both have a frame, the other's pose counts. Returns the numbers that the other's keyframes have here.
        """
        for view in {id(v): v for v in [*other.keyframes, *other.frames]}.values():
            view.moved(motion)
        for frame in other._tracked.values():
            frame.relative[:3, 3] *= motion.scale
        self._tracked |= other._tracked
        number = {view.index: n for n, view in enumerate(self.keyframes)}
        for view in self.keyframes:
            if view.index in other:
                view.T_wc = self[view.index]
        for view in other.keyframes:
            known = number.setdefault(view.index, len(self.keyframes))
            (self.keyframes if known == len(self.keyframes) else self.frames).append(view)
        self.frames.extend(other.frames)
        self._tracked = dict(sorted(self._tracked.items()))
        return [number[view.index] for view in other.keyframes]

    # -- correcting --------------------------------------------------------------------------------------------------

    def correct(self, correction: Correction) -> None:
        """Give frames their corrected poses, and move along what depends on them."""
        if not correction.poses:
            return
        if not correction.moves_world:
            self._set(correction.poses)
            return
        order = list(self._tracked)
        since = next(n for n, index in enumerate(order) if index in correction.poses)
        before = {index: self[index] for index in order[since:]}
        after, newest = propagate(before, correction.poses)
        motions = [
            keyframe_motion(before[k.index], after[k.index], correction.stretch.get(k.index, 1.0))
            if k.index in after
            else Sim3(1.0, np.eye(3), np.zeros(3))
            for k in self.keyframes
        ]
        self._set(after)
        motion = WorldMotion(motions, newest)
        for follower in self.followers:
            follower.world_moved(motion)

    def _set(self, poses: dict[int, Pose]) -> None:
        """Frames whose anchor is among these follow it."""
        for view in [*self.keyframes, *self.frames]:
            view.T_wc = poses.get(view.index, view.T_wc)
        for index, T_wc in poses.items():
            frame = self._tracked[index]
            if frame.anchor.index != index:
                frame.relative = invert_pose(frame.anchor.T_wc) @ T_wc


def propagate(before: dict[int, Pose], corrected: dict[int, Pose]) -> tuple[dict[int, Pose], Pose]:
    """Poses T_wc of all frames ``before``, in the order of tracking, once some are ``corrected``; the newest's motion.

    The others, which hardly moved or are younger, stay where they were relative to the last corrected one before them.
    """
    motion, after = np.eye(4), {}
    for index, T_wc in before.items():
        if index in corrected:
            motion = corrected[index] @ invert_pose(T_wc)
        after[index] = renormalise(motion @ T_wc)
    return after, motion


def keyframe_motion(before: Pose, after: Pose, stretch: float) -> Sim3:
    """The motion of a keyframe's Gaussians: they go along with it, and their distances from it grow by ``stretch``."""
    T = after @ invert_pose(before)
    return Sim3(stretch, T[:3, :3], T[:3, 3] + (1 - stretch) * T[:3, :3] @ before[:3, 3])

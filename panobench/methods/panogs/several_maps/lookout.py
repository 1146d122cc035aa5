"""Looking for the camera in a map that it has left, and how another map lies in that one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, distances_along
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.localise import Localiser
from panobench.methods.panogs.method import PanogsMethod, Phase
from panobench.methods.panogs.several_maps.joining import similarity
from panobench.types import Frame

Pose = NDArray[np.float64]
#: A map that follows another begins this near to where that was left: steps at the usual speed, median depths, and
#: the share of its own way by which it may have drifted until the two meet.
STEPS, DEPTHS, DRIFT = 1.5, 0.25, 0.02
#: Frames that are compared, at most: each try costs what its frames cost.
MOST = 120


def nearby(left: PanogsMethod, frames: int) -> float:
    """How far the camera is, at most, from where a map lost it so many frames ago, if there was no cut."""
    return STEPS * left.relocaliser.reach.usual(frames) + DEPTHS * left.mapper.scene_depth


class Lookout:
    """Looks for the camera in a map that it has left.

    cut: the recording does not go on where it was left. poses (4, 4) by frame index: where the camera was found in a
    row.
    """

    def __init__(self, left: PanogsMethod, config: PanogsConfig, cut: bool) -> None:
        self.map, self.cut, o = left, cut, config.atlas
        few = (o.common_after_cut, o.moved_after_cut) if cut else (o.common, o.moved)
        self.options = replace(o, common=few[0], moved=few[1])
        keyframes, renderer = left.trajectory.keyframes, left.tracker.renderer
        self.localiser = Localiser(renderer, config, keyframes, left.places, config.relocalisation.patience)
        self.last = max(left.trajectory)
        self.poses: dict[int, Pose] = {}

    def look(self, frame: Frame) -> None:
        found = self.localiser.look(frame, self.map.mapper.map.gaussians)
        if found is None or self.localiser.relocaliser.agreed < self.options.agree:
            self.poses.clear()
        else:
            self.poses[frame.index] = found.T_wc
            if len(self.poses) > MOST:
                del self.poses[min(self.poses)]

    @property
    def sure(self) -> bool:
        """Whether the camera is there, and may have come there since the map was left."""
        if len(self.poses) < self.options.common:
            return False
        first = min(self.poses)
        reach, depth = self.map.relocaliser.reach, self.map.mapper.scene_depth
        before, after = self.map.trajectory[self.last], self.poses[first]
        return self.cut or reach.allows(before, after, first - self.last, depth)

    def go_back(self) -> PanogsMethod:
        """The map, which goes on where the camera was found last."""
        left, tracker = self.map, self.localiser.tracker
        left.relocaliser.found(self.poses[max(self.poses)], tracker.pyramid[-1])
        left.tracker.velocity, left.phase = tracker.velocity, Phase.TRACKING
        return left

    def lies(self, other: PanogsMethod, poses: Mapping[int, Pose]) -> Sim3 | None:
        """The motion of another map's world into this one's, by the frames with ``poses`` here; None if unknown.

        Unless there was a cut, the other must begin about where this one was left: rooms may look alike.
        """
        theirs = {index: other.trajectory[index] for index in poses if index in other.trajectory}
        motion = similarity(poses, theirs, self.map.mapper.scene_depth, self.options)
        indices = [index for index in sorted(other.trajectory) if index > self.last]
        if motion is None or self.cut or not indices:
            return motion
        way = motion.apply_points([other.trajectory[index][:3, 3] for index in indices])
        length = float(distances_along(way)[-1])
        near = nearby(self.map, indices[0] - self.last) + DRIFT * length
        return motion if np.linalg.norm(way[0] - self.map.trajectory[self.last][:3, 3]) <= near else None

"""A session: one map and the frames that were tracked in it."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise
from panobench.methods.sparse.initialise import InitialFrame
from panobench.methods.sparse.pointmap import FrameRecord, Keyframe, PointMap

Array = NDArray[np.float64]


@dataclass
class Session:
    """One map and the frames that were tracked in it. velocity: T_cw of the last frame relative to the one before."""

    map: PointMap
    records: list[FrameRecord] = field(default_factory=list)
    T_cw: Array = field(default_factory=lambda: np.eye(4))
    velocity: Array = field(default_factory=lambda: np.eye(4))
    lost: int = 0
    last_loop: int = 0
    loops: int = 0
    relocalised: int = 0

    def pose_of(self, record: FrameRecord) -> Array:
        """T_cw (4, 4) of a frame from the current pose of its keyframe."""
        return renormalise(record.T_ck @ self.map.keyframes[record.keyframe].T_cw)

    def find(self, index: int) -> Array | None:
        """T_wc (4, 4) of a frame by its index, None if it has no pose here."""
        k = bisect_left(self.records, index, key=lambda r: r.index)
        if k == len(self.records) or self.records[k].index != index:
            return None
        return invert_pose(self.pose_of(self.records[k]))

    def add_initial(
        self, initial: InitialFrame, T_cw: Array, keyframe: Keyframe, point_of_track: NDArray[np.int64]
    ) -> None:
        """Record a frame of the initialisation. point_of_track (n,): the map's point of each track, -1 for none."""
        use = point_of_track[initial.tracks] >= 0
        T_ck = T_cw @ invert_pose(keyframe.T_cw)
        bearings = initial.bearings[use].astype(np.float32)
        self.records.append(
            FrameRecord(initial.index, initial.time, keyframe.number, T_ck, initial.tracks[use], bearings)
        )

    def grew(self, factor: float) -> None:
        """The map was scaled by ``factor``: what hangs on it follows."""
        self.velocity[:3, 3] *= factor
        for record in self.records:
            record.T_ck[:3, 3] *= factor

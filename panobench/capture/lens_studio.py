"""One lens of a rig in a room: each row seen from where the lens is when it is read, and who carries the rig."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.rig import RigLens
from panobench.capture.imu import BodyMotion
from panobench.capture.lenses import Lens
from panobench.capture.parts import Parts
from panobench.capture.scene import RoomScene
from panobench.capture.studio import RoomStudio
from panobench.rooms.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LensRide:
    """Where a lens's axes are, at the rig's origin: ``motion`` is that of the rig, ``R_rig_lens`` (3, 3) the lens's."""

    motion: BodyMotion
    R_rig_lens: Array

    def pose(self, t: float) -> Array:
        """(4, 4) at ``t`` seconds."""
        T = self.motion.poses(np.array([t]))[0]
        T[:3, :3] = T[:3, :3] @ self.R_rig_lens
        return T

    def rate(self, t: float) -> Array:
        """Angular velocity (3,) in the lens's axes, radians per second."""
        return np.asarray(self.R_rig_lens.T @ self.motion.rates(np.array([t]))[0])


class _OwnLens(Lens):
    """What is seen is not stitched: rays are the lens's own."""

    def rays(self, rays: Array) -> Array:
        return rays


class LensScene(RoomScene):
    """The room seen by a lens whose axes are turned against an upright rig's."""

    def __init__(self, world: World, lens: RigLens) -> None:
        super().__init__(world, lens.camera)
        self._turned = lens.T_rig_lens[:3, :3]

    @cached_property
    def mount(self) -> Array:
        return self._turned


class LensStudio(RoomStudio):
    """``image(index)`` is what the lens records at ``times[index]``; the rig's axes are an upright camera's.

    The parts that shape a panorama (gait, turn, levelling, stitching) have no effect: the motion and the lens do.
    """

    def __init__(
        self, world: World, lens: RigLens, motion: BodyMotion, parts: Parts, times: Array, noise: float, seed: int
    ) -> None:
        super().__init__(LensScene(world, lens), parts, times, noise, seed)
        self._lens, self._motion = lens, motion

    @cached_property
    def ride(self) -> LensRide:  # type: ignore[override]
        return LensRide(self._motion, self._lens.T_rig_lens[:3, :3])

    def _lenses(self, rays: Array) -> list[Lens]:
        T = self._lens.T_rig_lens
        return [_OwnLens(T[:3, :3].T @ T[:3, 3], np.ones(rays.shape[:2]))]

"""A built-in room through which somebody walks with the camera on the head, rendered as frames are asked for.

The rooms' own paths are made for pictures. These accelerate by each stride and turn like a head (``capture.stroll``),
for as long as a visual-inertial method needs to start.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.views import upright_rotation
from panobench.capture.imu import BodyMotion
from panobench.capture.stroll import StrollOptions, stroll
from panobench.datasets.base import FrameSequence
from panobench.errors import UnknownNameError
from panobench.geometry import make_pose
from panobench.rooms import cache, render
from panobench.rooms.kinds import KINDS
from panobench.rooms.options import parse_name
from panobench.rooms.world import World
from panobench.types import Trajectory

Array = NDArray[np.float64]


class WalkedRoom(FrameSequence):
    """A room, "room2" or "room2@7+noise0.01", seen by any camera. Of the variants only noise applies.

    rate: frames a second. R_upright_camera (3, 3): the camera's axes in those of an upright one that looks ahead; None:
    the camera's own, which is up for an annular lens. Frames are not kept. Raises UnknownNameError for another room.
    """

    dataset = "rooms"

    def __init__(
        self, room: str, walk: StrollOptions, camera: Camera, rate: float, R_upright_camera: Array | None = None
    ) -> None:
        kind, self._options = parse_name(room)
        if kind not in KINDS:
            raise UnknownNameError("built-in room", kind, KINDS)
        self.name, self.camera, self._walk = room, camera, walk
        self._mount = upright_rotation(camera) if R_upright_camera is None else R_upright_camera
        self._world, self._rate = World(kind, self._options.seed, None), rate
        self.times = np.arange(int(walk.seconds * rate)) / rate

    @cached_property
    def _T_wc(self) -> Array:
        walked = BodyMotion(stroll(self._world.plan.walk, self._walk)).poses(self.times)
        return np.asarray(walked @ make_pose(self._mount, np.zeros(3)))

    @cached_property
    def _bundle(self) -> render.RayBundle:
        return render.ray_bundle(self.camera)

    def image(self, index: int) -> NDArray[np.uint8]:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        i = index % len(self)
        linear = render.radiance(self._world.scene, self._bundle, self._T_wc[i], gain=self._world.path.exposure)
        return render.to_image(linear, sigma=self._options.noise, seed=self._walk.seed * 1_000_003 + i * 7919 + 17)

    @property
    def groundtruth(self) -> Trajectory:
        return Trajectory(self.times, self._T_wc)

    @property
    def world_up(self) -> Array:
        return np.array([0.0, 0.0, 1.0])

    def rendered_by(self, camera: Camera, R_target_source: Array) -> WalkedRoom:
        mount = self._mount @ np.asarray(R_target_source, dtype=np.float64).T
        return WalkedRoom(self.name, self._walk, camera, self._rate, mount)

    def provenance(self) -> dict[str, Any]:
        return {
            "generator": "panobench rooms",
            "generator_version": cache.GENERATOR_VERSION,
            "room": self.name,
            "walk": asdict(self._walk),
            "camera": self.camera.to_dict(),
        }

"""Several maps: where the camera is lost for good another one begins, and maps are joined where they can be.

The word is that of Campos et al., "ORB-SLAM3" (2021). A new map begins with frames from before the loss. If the old map
had these right, they join the two at once, as where a doorway shows too much that is new at a time. Else the new map
stands alone, as after a cut, until the camera is found in the old one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.depth.bootstrap import BootstrapDepth
from panobench.maps.saved import SavedMap
from panobench.methods.base import LiveMap, MethodContext, OnlineMethod
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.method import PanogsMethod, Phase
from panobench.methods.panogs.several_maps.cuts import CutDetector
from panobench.methods.panogs.several_maps.joining import join
from panobench.methods.panogs.several_maps.lookout import Lookout, nearby
from panobench.methods.panogs.tracking.flicker import Flicker
from panobench.types import Estimate, Frame

Pose = NDArray[np.float64]
#: Attempts at another map wait up to two to this power times as long as the first.
LONGEST = 3


class AtlasMethod(OnlineMethod):
    """One frame is: track it in the newest map; where that has lost it, begin another; join what can be joined.

    maps: those that are not joined, the newest last. beginning: one that waits for its first depth.
    """

    config: PanogsConfig
    uses_device = True

    def __init__(self, config: PanogsConfig | None = None) -> None:
        super().__init__(config or PanogsConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.camera, self.context, self.options = camera, context, self.config.atlas
        # The lenses of a rig may be turned any way, and are read apart from one another.
        flicker = self.config.exposure.flicker if context.rig is None else False
        self.flicker = Flicker(flicker, context.log)
        self._start_maps(context)

    def _start_maps(self, context: MethodContext) -> None:
        self.maps = [self._new_map(context)]
        # An IMU bridges gaps and a rig starts again in metres; a saved map is the only world there is.
        single = context.imu is not None or context.rig is not None or context.saved_map is not None
        self.enabled = self.options.enabled and not single and context.make_depth is not None
        self.lookouts: list[Lookout] = []
        self.turn = 0  # at a keyframe, one of them looks
        self.beginning: PanogsMethod | None = None
        self.recent: deque[Frame] = deque(maxlen=self.options.overlap)  # frames that were tracked last
        self.last = 0  # the last frame that was tracked
        self.missed: deque[Frame] = deque(maxlen=self.options.lost)  # the last frames that were not
        self.lost_for = 0  # frames since the last one that was tracked, or since the last attempt at another map
        self.failed = 0  # attempts at another map since
        self.cuts = CutDetector(self.camera, self.options.alike)
        self.cut = False  # between the last frame that was tracked and the first one that was not
        self.joined = self.joined_by_looks = 0

    def _new_map(self, context: MethodContext) -> PanogsMethod:
        new = PanogsMethod(self.config)
        new.start(self.camera, context)
        return new

    @property
    def newest(self) -> PanogsMethod:
        return self.maps[-1]

    # -- one frame -----------------------------------------------------------------------------------------------------

    def track(self, frame: Frame) -> Pose | None:
        if self.flicker.watching:
            again = self.flicker.watch(frame, waiting=self.newest.phase is Phase.WAITING)
            if again:
                self._start_maps(self.context)
                for earlier in again[:-1]:
                    self._track(earlier)
                return self._track(again[-1])
        return self._track(self.flicker.steady(frame))

    def _track(self, frame: Frame) -> Pose | None:
        self.newest.track(frame)
        if self.enabled and "blank" not in self.newest.numbers.get(frame.index, {}):
            is_cut = self.cuts.look(frame)
            if frame.index in self.newest.trajectory:
                self._found(frame, is_cut)
            elif self.newest.phase is Phase.LOST:
                self._missed(frame, is_cut)
        return self.maps[0].trajectory.get(frame.index)  # other worlds are told of once they are joined

    def _found(self, frame: Frame, is_cut: bool) -> None:
        """The newest map has the frame: no other one has to begin, but older ones may know the place, too."""
        if is_cut or (self.cut and self._is_far(self.last, frame.index)):
            self.joined_by_looks += 1
        self.last = frame.index
        self.recent.append(frame)
        self._forget_loss()
        is_keyframe = self.newest.numbers[frame.index].get("keyframe", 0.0) > 0
        self.turn += is_keyframe
        lookouts = list(self.lookouts)
        for n, lookout in enumerate(lookouts):
            if lookout.poses or (is_keyframe and n == self.turn % len(lookouts)):
                lookout.look(frame)
                self._join(lookout, lookout.poses)

    def _missed(self, frame: Frame, is_cut: bool) -> None:
        """The newest map has lost the frame: look in older ones, or begin another one and go over to it."""
        self.missed.append(frame)
        self.lost_for += 1
        if is_cut and frame.index == self.last + 1:  # what was seen before shows another place
            self.cut = True
            self.recent.clear()
        if not self._is_back(frame):
            self._begin(frame)

    def _is_back(self, frame: Frame) -> bool:
        """Whether the camera is in a map that it had left, which then goes on."""
        for lookout in self.lookouts:
            lookout.look(frame)
            if lookout.sure:
                self.joined_by_looks += lookout.cut
                self._go_over(lookout.go_back())
                return True
        return False

    def _begin(self, frame: Frame) -> None:
        """Begin another map once the camera has been lost for a while, and go over to it if it has the frame."""
        if self.beginning is not None:
            self.beginning.track(frame)
        elif self.lost_for >= self.options.lost * self._waits:
            self.beginning = self._new_map(replace(self.context, make_depth=BootstrapDepth, warn=self.context.log))
            for earlier in [*self.recent, *self.missed]:
                self.beginning.track(earlier)
        new = self.beginning
        if new is None:
            return
        if new.phase is Phase.WAITING:
            if self.recent and self.lost_for > self.options.patience:
                self._give_up()
        elif frame.index in new.trajectory and new.first_depth is not None and new.first_depth.ok:
            self._go_over(new)
        else:
            self._give_up()

    def _forget_loss(self) -> None:
        self.beginning, self.cut, self.failed, self.lost_for = None, False, 0, 0
        self.missed.clear()

    @property
    def _waits(self) -> int:
        """How much longer the next attempt waits: each costs about a second, and one that failed may fail again."""
        return int(2 ** min(max(self.failed - 1, 0), LONGEST))

    def _give_up(self) -> None:
        """What began is no map of where the camera is now: try again, without what was seen before the loss."""
        self.failed += 1
        self.beginning, self.lost_for = None, 0
        self.missed.clear()
        self.recent.clear()

    def _is_far(self, last: int, index: int) -> bool:
        """Whether the newest map found a frame elsewhere than about where it had lost the camera."""
        poses = self.newest.trajectory
        return bool(np.linalg.norm(poses[index][:3, 3] - poses[last][:3, 3]) > nearby(self.newest, index - last))

    def _go_over(self, new: PanogsMethod) -> None:
        """Leave the newest map for one that has begun, or for an older one."""
        left = Lookout(self.newest, self.config, self.cut)
        self.context.log(
            f"lost after frame {left.last}{' at a cut' * self.cut}: on in another map from frame {max(new.trajectory)}"
        )
        self.maps = [one for one in self.maps if one is not new] + [new]
        self.lookouts = [one for one in self.lookouts if one.map is not new] + [left]
        self._forget_loss()
        self.recent.clear()
        known = left.map.trajectory
        self._join(left, {index: known[index] for index in known if index in new.trajectory})

    def _join(self, older: Lookout, poses: Mapping[int, Pose]) -> None:
        """Make the newest map part of one that was left, if frames with ``poses`` in that show how."""
        newest = self.newest
        motion = older.lies(newest, poses)
        if motion is None:
            return
        join(older.map, newest, motion)
        self.joined += 1
        self.joined_by_looks += older.cut
        self.context.log(f"two maps joined by {len(poses)} frames: the newer one grows {motion.scale:.3f} times")
        self.maps = [one for one in self.maps if one is not older.map and one is not newest] + [older.map]
        self.lookouts = [one for one in self.lookouts if one is not older]

    # -- the end -------------------------------------------------------------------------------------------------------

    def finish(self) -> Estimate:
        """The answer of the map that has most frames; how many maps there are is in ``extra``."""
        self.beginning, largest = None, self._largest
        estimate = largest.finish()
        if self.flicker.bands is not None:
            estimate.extra["flicker"] = self.flicker.bands.numbers()
        if self.enabled:
            estimate.extra |= {"maps": len(self.maps), "joined": self.joined, "joined_by_looks": self.joined_by_looks}
        others = [one for one in self.maps if one is not largest]
        if others:
            frames = sum(len(one.trajectory) for one in others)
            self.context.warn(
                f"{len(others)} more maps with {frames} frames could not be joined to the largest: "
                "their frames have no pose"
            )
        return estimate

    @property
    def _largest(self) -> PanogsMethod:
        return max(self.maps, key=lambda one: len(one.trajectory))

    def saved_map(self) -> SavedMap | None:
        return self._largest.saved_map()

    def known_poses(self) -> dict[int, Pose]:
        return self._largest.known_poses()

    # -- looking at it -------------------------------------------------------------------------------------------------

    def live_map(self) -> LiveMap | None:
        return self.newest.live_map()

    def render(self, camera: Camera, T_wc: Pose) -> NDArray[np.float32] | None:
        return self._largest.render(camera, T_wc)

"""Looking back at a frame that saw things new: their depth from the frames that followed, and Gaussians for them.

Elsewhere the map has the last word: frames aligned to one map do not drift. The work is done in two parts, so that no
frame has to wait for both: ``sweep`` finds the depth, ``settle`` refines the poses since and inserts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.newdepth import NewDepth, Swept
from panobench.methods.panogs.recent import RecentFrame, RecentFrames
from panobench.methods.panogs.smoothing import Smoother
from panobench.methods.panogs.views import View
from panobench.photometric.overlap import ViewShare

Pose = NDArray[np.float64]
#: Frame number -> T_wc (4, 4).
PoseOf = Callable[[int], Pose]
#: So many frames are more than a sweep needs.
MANY = 8


@dataclass
class _Found:
    """others: frames whose poses are to be refined with the depth, none if they are as good as they get; used: those it
    was swept over.
    """

    swept: Swept
    used: list[RecentFrame]
    others: list[RecentFrame]


class LookBack:
    """The last frames, and what has been found by looking back at one of them but is not yet in the map."""

    def __init__(self, camera: Camera, config: PanogsConfig, mapper: Mapper) -> None:
        self.config, self.mapper = config, mapper
        self.recent = RecentFrames(camera, config.delay + 1)
        self.smoother = Smoother(self.recent.fine)
        self.new_depth = NewDepth(camera, self.recent.scale)
        self.view_share = ViewShare(camera)
        self.due = False  # a keyframe asks for it
        self._found: _Found | None = None

    @property
    def waiting(self) -> bool:
        """Something was found that ``settle`` has yet to put into the map."""
        return self._found is not None

    def sweep(self, pose: PoseOf, depth: float) -> None:
        """Look at the frame some way back for what it saw new, by the poses as they are. depth: the scene's, now."""
        self.due = False
        c, back = self.config, self.recent.split(self._delay(pose, depth))
        if back is None or not (c.smooth or c.sweep):
            return
        target, others = back
        if not self._sees_new(target, pose):
            self.smoother.keep(others)
            return
        self._find(target, others, pose, depth, refine=c.smooth)

    def sweep_last(self, pose: PoseOf, depth: float) -> None:
        """The same for the newest frame and those before it, when no frame will follow."""
        frames = self.recent.until_mappable()
        if self.config.sweep and len(frames) > self.config.delay_min and self._sees_new(frames[-1], pose):
            self._find(frames[-1], frames[:-1], pose, depth, refine=False)

    def _sees_new(self, target: RecentFrame, pose: PoseOf) -> bool:
        m, view = self.mapper, View(target.index, target.image, pose(target.index))
        render = m.renderer.forward(m.map, view.T_wc)
        return float(m.weights[m.unknown(view, render)].sum()) > self.config.sweep_share

    def _find(
        self, target: RecentFrame, others: list[RecentFrame], pose: PoseOf, depth: float, *, refine: bool
    ) -> None:
        """Sweep over ``others``, or every second one of many, from a tenth of to 15 times the scene's depth."""
        used = others[::-2][::-1] if len(others) >= MANY else others
        swept = self.new_depth.sweep(target, used, _seen_from(target, used, pose), depth)
        self._found = None if swept is None else _Found(swept, used, others if refine else [])

    def settle(self, pose: PoseOf, move: Callable[[dict[int, Pose]], None]) -> None:
        """Refine the poses since the frame looked back at, which ``move`` receives, and insert what was found."""
        if self._found is None:
            return
        m, found, self._found = self.mapper, self._found, None
        target = found.swept.target
        swept = found.swept.again(_seen_from(target, found.used, pose))
        view = View(target.index, target.image, pose(target.index))
        render = m.renderer.forward(m.map, view.T_wc, sloped=True)
        mapped = render.expected_depth(0.5)
        if found.others:
            scale = self.new_depth.map_over_swept(swept, mapped)
            move(self.smoother.refine(target, found.others, pose, swept.depth, scale))
            swept = swept.again(_seen_from(target, found.used, pose))
        if self.config.sweep:
            disproved = self.new_depth.disproved(swept, mapped)
            m.insert(view, render, self.new_depth.full_size(swept, self.config.sweep_confidence), disproved)

    def _delay(self, pose: PoseOf, depth: float) -> int:
        """Frames to look back: as many as still show most of what the newest sees, which on a full panorama is all."""
        c = self.config
        if not self.view_share.narrow or len(self.recent) < c.delay_min + 1:
            return c.delay
        newest = self.recent.before(0)
        for delay in range(min(c.delay, len(self.recent) - 1), c.delay_min, -1):
            target = self.recent.before(delay)
            T = invert_pose(pose(newest.index)) @ pose(target.index)
            if self.view_share.of(T, depth) >= c.delay_share:
                return delay
        return c.delay_min


def _seen_from(target: RecentFrame, others: list[RecentFrame], pose: PoseOf) -> Pose:
    """T_fr (F, 4, 4) of ``others`` from ``target``."""
    return np.stack([invert_pose(pose(f.index)) @ pose(target.index) for f in others])

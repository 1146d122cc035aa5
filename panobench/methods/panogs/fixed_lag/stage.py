"""What is done some frames behind the tracker: depth of new regions, and smoothing of the poses since.

A frame that sees something new receives depth for it once ``lag`` frames have followed. Elsewhere the map has the last
word, because frames aligned to one map do not drift. The work is in two parts, so that no frame has to wait for both:
``sweep`` finds the depth, ``insert`` smooths the poses and puts the new Gaussians into the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.panogs.config import FixedLagOptions
from panobench.methods.panogs.fixed_lag.entering import EnteringDepth
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame, FrameBuffer
from panobench.methods.panogs.fixed_lag.lag_smoother import LagSmoother
from panobench.methods.panogs.fixed_lag.swept_depth import DepthSweep, SweptDepth
from panobench.methods.panogs.mapping.frame_votes import FrameVotes
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric.overlap import ViewShare, ViewWidth
from panobench.splat.gaussians import F32
from panobench.splat.render import Render
from panobench.types import Frame

#: A sweep over so many frames takes every second one.
MANY = 8
#: Share of a narrow view that must be new for the depth of what enters it to be looked for at once.
ENTERING_SHARE = 0.02


@dataclass
class _Found:
    """A swept depth that is not in the map yet. used: the frames it was swept over; smoothed: those whose poses are to
    be refined with it.
    """

    swept: SweptDepth
    used: list[BufferedFrame]
    smoothed: list[BufferedFrame]


class FixedLag:
    """The last frames, and the depth that was swept over them but is not in the map yet."""

    def __init__(
        self, camera: Camera, options: FixedLagOptions, mapper: Mapper, trajectory: AnchoredTrajectory
    ) -> None:
        self.options, self.mapper, self.trajectory = options, mapper, trajectory
        self.buffer = FrameBuffer(camera, options)
        self.depth_sweep = DepthSweep(camera, self.buffer.sweep_scale, options)
        self.votes = FrameVotes(camera, trajectory)
        self.smoother = LagSmoother(self.buffer.fine_scale, options)
        self.width, self.view_share = ViewWidth.of(camera), ViewShare(camera)
        self.entering = EnteringDepth(options, self.buffer, self.depth_sweep, mapper, trajectory)
        self.sweep_wanted = False
        self._found: _Found | None = None

    @property
    def can_insert(self) -> bool:
        """A depth was swept that ``insert`` has yet to put into the map."""
        return self._found is not None

    def keyframe(self, frame: Frame, scene_depth: float, new_share: float) -> None:
        """A keyframe, of which ``new_share`` is new: its depth is wanted, in a narrow view that of what enters at once.

        scene_depth: median depth of what it sees.
        """
        self.sweep_wanted = True
        if self.width is ViewWidth.NARROW and self.options.sweep and new_share > ENTERING_SHARE:
            self.entering.insert(frame, scene_depth)

    def sweep(self, scene_depth: float) -> None:
        """Sweep the depth of what the frame at the lag sees new, by the poses as they are now."""
        self.sweep_wanted = False
        o = self.options
        parts = self.buffer.split(self._lag(scene_depth))
        if parts is None or not (o.smooth or o.sweep):
            return
        target, others = parts
        if not self._sees_new(target):
            self.smoother.mark_refined(others)
            return
        self._find(target, others, scene_depth, smooth=o.smooth)

    def sweep_last(self, scene_depth: float) -> None:
        """The same for the newest frame over those before it, once no frame follows."""
        frames = self.buffer.until_mappable()
        if self.options.sweep and len(frames) > self.options.lag_min and self._sees_new(frames[-1]):
            self._find(frames[-1], frames[:-1], scene_depth, smooth=False)

    def insert(self) -> None:
        """Smooth the poses since the swept frame, and put what it sees new into the map."""
        if self._found is None:
            return
        m, trajectory, found, self._found = self.mapper, self.trajectory, self._found, None
        target = found.swept.target
        used = [f.index for f in found.used]
        swept = found.swept.rescaled(trajectory.relative(target.index, used))
        view = View(target.index, target.image, trajectory[target.index], visible=target.visible)
        render = m.occluded.look(m.renderer, view.T_wc, sloped=True)
        mapped = render.expected_depth(0.5)
        if found.smoothed:
            scale = self.depth_sweep.map_over_swept(swept, mapped)
            trajectory.correct(self.smoother.refine(target, found.smoothed, trajectory, swept.depth, scale))
            swept = swept.rescaled(trajectory.relative(target.index, used))
        if self.options.sweep:
            disproved = self.depth_sweep.disproved(swept, mapped)
            confirmed = None
            if m.transients.active:
                confirmed = self._confirmed(view, render, mapped, swept, m.wrong(view, render) | disproved)
            m.insert(view, render, self.depth_sweep.full_size(swept), disproved, confirmed)

    def _confirmed(
        self, view: View, render: Render, mapped: F32, swept: SweptDepth, doubted: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """(H, W): where the frames since, and most of all frames, show what the swept frame does, and not the map."""
        votes = self.votes
        agreed = self.depth_sweep.confirmed(swept, self.mapper.config.moving.confirmed)
        where = votes.small(doubted.view(np.uint8)) > 0
        drawn = votes.soft(np.ascontiguousarray(255 * render.colour))
        for_map = votes.count(view.T_wc, where, votes.small(mapped), drawn)
        for_frame = votes.count(view.T_wc, where, votes.small(swept.depth), votes.soft(view.image))
        preferred = np.zeros(where.shape, np.uint8)
        preferred[where] = for_frame > for_map
        agreed &= cv2.resize(preferred, agreed.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
        return self.depth_sweep.by_area(agreed, doubted)

    def _sees_new(self, target: BufferedFrame) -> bool:
        m, T_wc = self.mapper, self.trajectory[target.index]
        view = View(target.index, target.image, T_wc, visible=target.visible)
        render = m.occluded.look(m.renderer, view.T_wc)
        return float(m.weights[m.unknown(view, render)].sum()) > self.options.new_share

    def _find(self, target: BufferedFrame, others: list[BufferedFrame], scene_depth: float, *, smooth: bool) -> None:
        used = others[::-2][::-1] if len(others) >= MANY else others
        T_fr = self.trajectory.relative(target.index, [f.index for f in used])
        swept = self.depth_sweep.sweep(target, used, T_fr, scene_depth)
        self._found = None if swept is None else _Found(swept, used, others if smooth else [])

    def _lag(self, scene_depth: float) -> int:
        """As many frames as still share most of the newest's view, which on a full panorama is all."""
        o = self.options
        if self.width is ViewWidth.WIDE or len(self.buffer) < o.lag_min + 1:
            return o.lag
        newest = self.buffer.before(0).index
        for lag in range(min(o.lag, len(self.buffer) - 1), o.lag_min, -1):
            T_fr = self.trajectory.relative(self.buffer.before(lag).index, [newest])[0]
            if self.view_share.of(T_fr, scene_depth) >= o.view_share:
                return lag
        return o.lag_min

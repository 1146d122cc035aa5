"""Relocalisation: noticing that the camera is lost, and finding it again.

A frame whose residuals are usual is not checked further. Others are compared with the map block by block
(``agreement``). If too little agrees, alignment starts again from other poses: the last good one, yawed as thumbnails
say, and the keyframes that look most alike. The best pose that the map explains, and that the camera can have reached
since its last one, is taken; without one the camera is lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, make_pose, renormalise
from panobench.inertial.prediction import looks_elsewhere
from panobench.methods.panogs.config import RelocalisationOptions
from panobench.methods.panogs.factor_graph.place_recognition import Places, yawed
from panobench.methods.panogs.tracking.agreement import COARSE, FINE, agreement
from panobench.methods.panogs.tracking.reach import Reach
from panobench.methods.panogs.tracking.tracker import Tracked, Tracker
from panobench.methods.panogs.trajectory import WorldMotion
from panobench.methods.splatting.views import View
from panobench.photometric.align import align
from panobench.photometric.pyramid import F32
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Render

Pose = NDArray[np.float64]
#: The search starts from the places of so many keyframes around the expected one, if one is expected.
NEAR_KEYFRAMES = 3


class Relocaliser:
    """Judges tracked frames. places: one thumbnail for each keyframe, in their order.

    strict: whether a pose must show itself in fine detail, as it must where the camera enters a saved map. agreed: the
    agreement of the last frame that was compared with the map.
    """

    def __init__(self, tracker: Tracker, places: Places, options: RelocalisationOptions) -> None:
        self.tracker, self.places, self.options, self.strict = tracker, places, options, False
        self.fine = FINE.for_camera(tracker.camera)
        # Exposure may have changed since a place was mapped.
        self.align_options = replace(tracker.align_options, exposure=True)
        self.usual: deque[float] = deque(maxlen=options.usual_frames)
        self.reach = Reach(options.usual_frames)
        self.lost_for = 0
        self.agreed = 0.0
        self._good: tuple[Pose, F32] | None = None

    def interrupted(self) -> None:
        """A frame had no pose: the next one is checked whatever its residuals are."""
        self.lost_for += 1

    def elsewhere(self) -> None:
        """The next frame does not follow the last one."""
        self.lost_for += 1
        self._good = None

    def found(self, T_wc: Pose, luma: F32) -> None:
        """The camera is known to be at ``T_wc`` (4, 4), where it sees ``luma`` (h, w); what was usual says nothing."""
        self.lost_for, self._good = 0, (T_wc, luma)
        self.usual.clear()
        self.tracker.restart(T_wc)

    def judge(
        self, tracked: Tracked, gaussians: GaussianMap, keyframes: Sequence[View], expected: Pose | None = None
    ) -> Tracked | None:
        """``tracked`` if it can be trusted, else what a search finds, else None: the camera is lost.

        expected (4, 4): where an IMU expects the camera, None if nothing is known.
        Sets the tracker's state to what it returns, or to the last pose that was trusted.
        """
        o = self.options
        if not o.enabled:
            return tracked
        residual = tracked.cost if tracked.alignment is None else tracked.alignment.sigma
        if looks_elsewhere(tracked.T_wc, expected):
            return self._search(tracked, gaussians, keyframes, expected)
        usual = self.lost_for == 0 and len(self.usual) > 0 and residual <= o.unusual * float(np.median(self.usual))
        if not (usual and tracked.good):
            checked = self._checked(tracked, gaussians, o.agree_lost if self.lost_for else o.agree_tracked)
            if checked is None:
                return self._search(tracked, gaussians, keyframes, expected)
            tracked = checked
        self._accept(tracked, residual)
        return tracked

    def _checked(self, tracked: Tracked, gaussians: GaussianMap, needed: float) -> Tracked | None:
        """``tracked`` if enough of the frame agrees with the map there; the render may be of a pose a bit before."""
        if not tracked.good:
            return None
        if self.strict:
            needed = self.options.agree_entry
        self.agreed = self._agreement(tracked.render)
        if self.agreed >= needed:
            return tracked
        render = self._render(gaussians, tracked.T_wc)
        self.agreed = self._agreement(render)
        return replace(tracked, render=render) if self.agreed >= needed else None

    def _agreement(self, render: Render) -> float:
        """Of the newest frame with a render, in the detail that is asked for."""
        return agreement(self.tracker.pyramid, render, self.tracker.weights, self.fine if self.strict else COARSE)

    def world_moved(self, motion: WorldMotion) -> None:
        """As ``WorldFollower.world_moved``: the last good pose goes along."""
        if self._good is not None:
            self._good = (motion.newest @ self._good[0], self._good[1])

    def _reachable(self, found: Tracked, expected: Pose | None) -> bool:
        if self._good is None or self.strict:
            return True
        depth = float(np.median(found.render.depth[self.tracker.valid]))
        return self.reach.allows(self._good[0], found.T_wc, self.lost_for + 1, depth, expected)

    def _accept(self, tracked: Tracked, residual: float) -> None:
        self.usual.append(residual)
        if self._good is not None:
            self.reach.record(self._good[0], tracked.T_wc, self.lost_for + 1)
        self.lost_for = 0
        self._good = (tracked.T_wc, self.tracker.pyramid[-1])

    def _search(
        self, tracked: Tracked, gaussians: GaussianMap, keyframes: Sequence[View], expected: Pose | None
    ) -> Tracked | None:
        frame = self.tracker.pyramid
        best, most = None, self.options.agree_entry if self.strict else self.options.agree_lost
        for start in self._starts(frame[-1], keyframes, expected):
            found = self.descend(frame, gaussians, start)
            possible = found.good and self._reachable(found, expected)
            share = self._agreement(found.render) if possible else 0.0
            if share >= most:
                best, most = found, share
                self.agreed = share
            if share >= self.options.agree_surely:
                break
        self.tracker.reference = None  # it may be of anywhere
        if best is None:
            self.lost_for += 1
            self.tracker.reset(self._good[0] if self._good else tracked.T_wc)
            return None
        self.tracker.reset(best.T_wc)
        self._accept(best, best.alignment.sigma if best.alignment else best.cost)
        return best

    def _starts(self, luma: F32, keyframes: Sequence[View], expected: Pose | None) -> list[Pose]:
        o, asked = self.options, self.places.thumbnail(luma)
        known = [] if expected is None else self._starts_of(expected, keyframes)
        starts = list(known)
        if self._good is not None:
            T, last = self._good
            starts.append(T)
            starts += [yawed(T, yaw) for _, yaw in self.places.compare(self.places.thumbnail(last), asked, peaks=2)]
        alike = [m for m in self.places.find(asked, o.starts) if m.score >= o.likeness_min]
        starts += [yawed(keyframes[m.number].T_wc, m.yaw) for m in alike]
        if self.lost_for < o.patience:
            return starts[: o.starts]
        return known + [yawed(keyframes[m.number].T_wc, m.yaw) for m in alike[: o.starts_later]]

    def _starts_of(self, expected: Pose, keyframes: Sequence[View]) -> list[Pose]:
        """Looking the way that is expected: from there, from the last good pose's place, from keyframes' around it."""
        places = np.stack([view.position for view in keyframes])
        away = np.linalg.norm(places - expected[:3, 3], axis=1)
        near = places[np.argsort(away, kind="stable")[:NEAR_KEYFRAMES]]
        last = [] if self._good is None else [self._good[0][:3, 3]]
        return [expected, *(make_pose(expected[:3, :3], place) for place in [*last, *near])]

    def descend(self, frame: list[F32], gaussians: GaussianMap, T_wc: Pose) -> Tracked:
        """Align on all levels to fresh renders until the frame stays where it is; the render is of the final pose."""
        tracker, T, iterations = self.tracker, T_wc, 0
        for _ in range(self.options.rounds):
            render = tracker.renderer.forward(gaussians, T, sloped=True)
            a = align(tracker.make_reference(render, len(frame)), frame, np.eye(4), self.align_options)
            T = renormalise(T @ invert_pose(a.T_fr))
            iterations += a.iterations
            if tracker.moved_px(a.T_fr, render) < 1.0:
                break
        render = self._render(gaussians, T)
        return Tracked(T, render, a.cost, iterations, bool(np.isfinite(a.cost)) and a.overlap > 0.5, a)

    def _render(self, gaussians: GaussianMap, T_wc: Pose) -> Render:
        return self.tracker.renderer.forward(gaussians, T_wc, count_touched=True, sloped=True)

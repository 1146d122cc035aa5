"""Noticing that the camera is lost, and finding it again.

A frame whose residuals are usual is not looked at twice. Others are compared with the map block by block
(``agreement``). If too little agrees, alignment starts anew from other poses: where the camera last was, turned as
thumbnails say, and at the keyframes that look most alike. What the map explains is the pose; else there is none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise
from panobench.methods.panogs.agreement import agreement
from panobench.methods.panogs.places import Places, turned
from panobench.methods.panogs.tracker import Tracked, Tracker
from panobench.methods.panogs.views import View
from panobench.photometric.align import align
from panobench.photometric.pyramid import F32
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Render

Pose = NDArray[np.float64]

#: Residual over the last frames' median from which a frame is looked at, and how many frames make a median.
UNUSUAL, USUAL_FRAMES = 1.5, 20
#: Agreement below which a pose is not believed, for a camera that was tracked and for one that was lost.
AGREE_TRACKED, AGREE_LOST = 0.4, 0.5
#: Agreement at which the search ends at once.
AGREE_SURELY = 0.85
#: Likeness of a keyframe worth a start, and most starts per frame: just lost, and after ``PATIENCE`` frames.
LIKENESS_MIN = 0.25
STARTS, STARTS_LATER, PATIENCE = 8, 3, 5
#: Rounds of rendering and alignment from one start.
ROUNDS = 4


class Relocaliser:
    """Judges tracked frames; ``places`` has one thumbnail for each keyframe, in their order."""

    def __init__(self, tracker: Tracker, places: Places) -> None:
        self.tracker, self.places = tracker, places
        # Exposure may have changed since a place was mapped.
        self.options = replace(tracker.options, exposure=True)
        self.usual: deque[float] = deque(maxlen=USUAL_FRAMES)
        self.lost_for = 0
        self._good: tuple[Pose, F32] | None = None

    def interrupted(self) -> None:
        """A frame showed nothing: the next is looked at whatever its residuals."""
        self.lost_for += 1

    def judge(self, tracked: Tracked, gaussians: GaussianMap, keyframes: Sequence[View]) -> Tracked | None:
        """``tracked`` if it can be believed, else what a search finds, else None. Sets the tracker's state."""
        residual = tracked.cost if tracked.alignment is None else tracked.alignment.sigma
        calm = self.lost_for == 0 and len(self.usual) > 0 and residual <= UNUSUAL * float(np.median(self.usual))
        if not (calm and tracked.good):
            checked = self._checked(tracked, gaussians, AGREE_LOST if self.lost_for else AGREE_TRACKED)
            if checked is None:
                return self._search(tracked, gaussians, keyframes)
            tracked = checked
        self._accept(tracked, residual)
        return tracked

    def _checked(self, tracked: Tracked, gaussians: GaussianMap, needed: float) -> Tracked | None:
        """``tracked`` if enough of the frame agrees with the map there; the render may be of a pose a bit before."""
        frame, weights = self.tracker.pyramid, self.tracker.weights
        if not tracked.good:
            return None
        if agreement(frame, tracked.render, weights) >= needed:
            return tracked
        render = self._render(gaussians, tracked.T_wc)
        return replace(tracked, render=render) if agreement(frame, render, weights) >= needed else None

    def moved(self, move: Callable[[Pose], Pose]) -> None:
        """The map was moved (a loop was closed): the last good pose goes with it."""
        if self._good is not None:
            self._good = (move(self._good[0]), self._good[1])

    def _accept(self, tracked: Tracked, residual: float) -> None:
        self.usual.append(residual)
        self.lost_for = 0
        self._good = (tracked.T_wc, self.tracker.pyramid[-1])

    def _search(self, tracked: Tracked, gaussians: GaussianMap, keyframes: Sequence[View]) -> Tracked | None:
        frame = self.tracker.pyramid
        best, most = None, AGREE_LOST
        for start in self._starts(frame[-1], keyframes):
            found = self.descend(frame, gaussians, start)
            share = agreement(frame, found.render, self.tracker.weights) if found.good else 0.0
            if share >= most:
                best, most = found, share
            if share >= AGREE_SURELY:
                break
        self.tracker.reference = None  # it may be of anywhere
        if best is None:
            self.lost_for += 1
            self.tracker.reset(self._good[0] if self._good else tracked.T_wc)
            return None
        # The mapper goes on from the renderer's last picture.
        best = replace(best, render=self._render(gaussians, best.T_wc))
        self.tracker.reset(best.T_wc)
        self._accept(best, best.alignment.sigma if best.alignment else best.cost)
        return best

    def _starts(self, luma: F32, keyframes: Sequence[View]) -> list[Pose]:
        asked = self.places.thumbnail(luma)
        starts: list[Pose] = []
        if self._good is not None:
            T, last = self._good
            starts.append(T)
            starts += [turned(T, yaw) for _, yaw in self.places.compare(self.places.thumbnail(last), asked, peaks=2)]
        alike = [m for m in self.places.find(asked, STARTS) if m.score >= LIKENESS_MIN]
        starts += [turned(keyframes[m.number].T_wc, m.yaw) for m in alike]
        if self.lost_for < PATIENCE:
            return starts[:STARTS]
        return [turned(keyframes[m.number].T_wc, m.yaw) for m in alike[:STARTS_LATER]]

    def descend(self, frame: list[F32], gaussians: GaussianMap, T_wc: Pose) -> Tracked:
        """Align on all levels to fresh renders until the frame stays where it is; the render is of the final pose."""
        tracker, T, iterations = self.tracker, T_wc, 0
        for _ in range(ROUNDS):
            render = tracker.renderer.forward(gaussians, T, sloped=True)
            a = align(tracker.make_reference(render, len(frame)), frame, np.eye(4), self.options)
            T = renormalise(T @ invert_pose(a.T_fr))
            iterations += a.iterations
            if tracker.moved_px(a.T_fr, render) < 1.0:
                break
        render = self._render(gaussians, T)
        return Tracked(T, render, a.cost, iterations, bool(np.isfinite(a.cost)) and a.overlap > 0.5, a)

    def _render(self, gaussians: GaussianMap, T_wc: Pose) -> Render:
        return self.tracker.renderer.forward(gaussians, T_wc, count_touched=True, sloped=True)

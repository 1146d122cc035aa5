"""The trajectory behind the tracker: windows of bundle adjustment around every few frames, and what suits them all.

A pose found by aligning a frame to a rendered map is off by what the map is off by, and so are its neighbours'.
Frames compared with one another, each reference with those up to a second before and after it, do not know the map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, invert_pose, renormalise
from panobench.methods.panogs.laps import Laps
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pyramid import F32, halve
from panobench.photometric.stereo import WorkingScale
from panobench.photometric.windows import PosePrior, Window, fit_trajectory, log_scale, reduced

Pose = NDArray[np.float64]
#: Poses are good when they come: few iterations. Depths need not be: the nearest frames first, the worst pixels out.
OPTIONS = BundleOptions(cell_px=6, iterations=4, cut=5.0, trim=0.6, near=12)
#: In narrow views depth and motion are told apart by few pixels, and by the far frames: all of both are needed.
NARROW = BundleOptions(cell_px=8, iterations=5, cut=5.0)
#: A reference every so many frames that moved, and how many frames on either side it is compared with.
EVERY, REACH = 8, 24
#: A window is made again, once so many frames have followed, if the map's depth has changed by this share since: the
#: first view of a new room is mapped from little parallax.
AGAIN, CHANGED = 2 * REACH, 0.01
#: Frames a window may wait for other work.
LATE = 4
#: Frames whose poses a fit may change; windows before them are forgotten.
FREE = 96
#: What a pose from the map is trusted by: translation over the scene's depth, and radians.
PRIOR_TRANSLATION, PRIOR_ROTATION = 0.006, 0.005


@dataclass(frozen=True)
class Fit:
    """poses: T_wc by frame index; free: indices of those that could move; stretch: the factor by which distances
    between these have grown, on average.
    """

    poses: dict[int, Pose]
    free: frozenset[int] = frozenset()
    stretch: float = 1.0


@dataclass
class _Frame:
    index: int
    luma: F32 | None  # None once no window needs it
    depth: F32 | None = None  # what its window was made with, at a fraction of the size


class Backend:
    """Frames that moved are numbered in order; the images of the first and the last some are kept."""

    def __init__(self, scale: WorkingScale, laps: Laps | None = None, *, narrow: bool = False) -> None:
        self.scale, self.laps, self.options = scale, laps, NARROW if narrow else OPTIONS
        self.frames: list[_Frame] = []
        self.windows: list[Window] = []
        self.unfitted = False  # a window has come since the last fit
        self._next, self._again, self._turned = 0, 0, False

    def add(self, index: int, luma: F32) -> None:
        """A frame by its index in the sequence, luma (h, w) at the working size."""
        self.frames.append(_Frame(index, luma))
        old = len(self.frames) - 1 - AGAIN - REACH - EVERY - LATE
        if old > REACH + 1:  # the very first are wanted again if frames before them are (``turn``)
            self.frames[old - 1].luma = None

    def turn(self) -> None:
        """What comes goes on from the first frame, backwards in time."""
        last = len(self.frames) - 1
        self.frames.reverse()
        self.windows = [Window(last - w.reference, last - w.frames, w.bundle) for w in self.windows]
        self._next = self._again = max(last, 0)
        self._turned = True

    def due(self, *, at_the_end: bool = False) -> int | None:
        """Number of the frame that should get its window now: ``REACH`` frames have followed it, or none will."""
        count = len(self.frames)
        if self._next < count - (1 if at_the_end else REACH):
            return self._next
        if self._again < min(count - (1 if at_the_end else AGAIN), self._next):
            return self._again
        return None

    def overdue(self) -> bool:
        """The window that is due has been for ``LATE`` frames."""
        count = len(self.frames)
        return self._next < count - REACH - LATE or self._again < min(count - AGAIN - LATE, self._next)

    def adjust(self, k: int, pose: Callable[[int], Pose], depth: F32) -> None:
        """The window of frame ``k``, which is due; ``depth`` (H, W), radial, NaN where unknown; pose: index -> T_wc.

        Its second visit makes it again only if the depth has changed much. Then the window is final and goes to laps.
        """
        s, again, target = self.scale, k != self._next, self.frames[k]
        if again:
            self._again += EVERY
        else:
            self._next += EVERY
        if target.luma is None:
            return
        known = cv2.resize(depth, s.valid.shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.float32)
        known = np.where(s.valid & np.isfinite(known), known, 0).astype(np.float32)
        sample = known[:: max(known.shape[0] // 32, 1), :: max(known.shape[1] // 64, 1)]
        if not again or _changed(target.depth, sample):
            target.depth = sample.copy()
            self._make(k, known, pose)
        if again and self.laps is not None and not self._turned:
            window = next((w for w in self.windows if w.reference == k), None)
            self.laps.add(k, self._small(target.luma), window and reduced(window, (window.frames - k) % EVERY == 0))
            self.laps.look(lambda n: pose(self.frames[n].index), depth)

    def _make(self, k: int, known: F32, pose: Callable[[int], Pose]) -> None:
        """The window of frame ``k`` by its depth at the working size, 0 where unknown."""
        s, target = self.scale, self.frames[k]
        near = [(n, self.frames[n]) for n in range(max(k - REACH, 0), min(k + REACH + 1, len(self.frames)))]
        others = [(n, f.luma) for n, f in near if n != k and f.luma is not None]
        if target.luma is None or not others:
            return
        numbers = np.array([n for n, _ in others])
        T_wr = pose(target.index)
        T_fr = np.stack([invert_pose(pose(self.frames[n].index)) @ T_wr for n in numbers])
        images = np.stack([luma for _, luma in others])
        bundle = refine(target.luma, s.rays, known, images, T_fr, s.code, s.cam, self.options)
        if bundle.ok:
            self.windows = [w for w in self.windows if w.reference != k] + [Window(k, numbers, bundle)]
            self.unfitted = True

    def _small(self, luma: F32) -> F32:
        assert self.laps is not None
        while luma.shape[1] > self.laps.scale.valid.shape[1]:
            luma = halve(luma)
        return luma

    def close(self, pose: Callable[[int], Pose], depth: float) -> Fit:
        """What suits all windows there were, if the camera came back to where it had been; depth: the scene's."""
        if self.laps is None or self._turned:
            return Fit({})
        closed = self.laps.close(lambda n: pose(self.frames[n].index), depth)
        return Fit({self.frames[n].index: T for n, T in closed.items()})

    def fit(self, pose: Callable[[int], Pose], depth: float) -> Fit:
        """What suits all windows, for the last ``FREE`` frames; those before stay. depth: the scene's."""
        self.unfitted = False
        count = len(self.frames)
        free = max(count - FREE, 1)
        self.windows = [w for w in self.windows if max(w.reference, w.frames.max()) >= free]
        if not self.windows:
            return Fit({})
        lo = min(min(w.reference, int(w.frames.min())) for w in self.windows)
        indices = [f.index for f in self.frames[lo:]]
        before = np.stack([pose(i) for i in indices])
        windows = [Window(w.reference - lo, w.frames - lo, w.bundle) for w in self.windows]
        prior = PosePrior(PRIOR_TRANSLATION * depth, PRIOR_ROTATION)
        after = fit_trajectory(before, windows, prior, np.arange(lo, count) < free)
        # Noise in the poses before would pass for length; those after have little.
        shrunk = [log_scale(*(invert_pose(T[w.frames]) @ T[w.reference] for T in (after, before))) for w in windows]
        poses, free_indices = dict(zip(indices, after)), frozenset(indices[max(free - lo, 0) :])
        if self._turned:  # those before do not come first in the order of tracking: they must not follow
            poses |= {f.index: pose(f.index) for f in self.frames[:lo]}
        return Fit(poses, free_indices, float(np.exp(-np.mean(shrunk))))


def _changed(before: F32 | None, after: F32) -> bool:
    """By ``CHANGED`` or more, for the median pixel that is known in both."""
    if before is None:
        return True
    both = (before > 0) & (after > 0)
    return bool(both.any()) and float(np.median(np.abs(np.log(after[both] / before[both])))) > CHANGED


def followed(before: dict[int, Pose], fitted: dict[int, Pose]) -> tuple[dict[int, Pose], Pose]:
    """Poses T_wc of all frames ``before`` by index, once some are ``fitted``, and what the newest was moved by.

    ``before`` is in the order of tracking. The others, which hardly moved or are younger, stay where they were to the
    last fitted one before them.
    """
    move, after = np.eye(4), {}
    for index, T_wc in before.items():
        if index in fitted:
            move = fitted[index] @ invert_pose(T_wc)
        after[index] = renormalise(move @ T_wc)
    return after, move


def moved_by(before: Pose, after: Pose, stretch: float) -> Sim3:
    """What a keyframe's Gaussians move by: along with it, and their distances from it grow by ``stretch``."""
    T = after @ invert_pose(before)
    return Sim3(stretch, T[:3, :3], T[:3, 3] + (1 - stretch) * T[:3, :3] @ before[:3, 3])

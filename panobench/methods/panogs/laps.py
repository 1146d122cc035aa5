"""Coming back: windows with frames of both visits, and the whole trajectory once they are known.

A window of bundle adjustment does not care when its frames were taken. Where the camera returns to, the reference is
compared with those that stood there long before as well; this ties the visits together at one scale. In the end the
trajectory that suits all windows is solved for, over references only: the frames between them follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.photometric.align import Alignment, align
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pyramid import F32, pyramid
from panobench.photometric.reference import Reference, make_reference
from panobench.photometric.stereo import WorkingScale
from panobench.photometric.windows import PosePrior, Window, fit_trajectory, reduced

Pose = NDArray[np.float64]
#: One pixel in 5 x 5, at half the size of other windows.
OPTIONS = BundleOptions(cell_px=5, iterations=6, cut=5.0)
#: Frames that moved after which a place is an old one, and how near it must be, over the scene's depth.
OLD, NEAR = 200, 0.3
#: Old references compared with, at most; recent ones on either side.
OLD_MOST, RECENT = 6, 3
#: An old reference must be seen as well as recent ones are: cost over their median cost, and share of the view.
COST_MAX, OVERLAP_MIN = 2.0, 0.6
#: Standard deviations of the poses as they were, over the scene's depth and in radians: they have drifted.
PRIOR_TRANSLATION, PRIOR_ROTATION = 1.0, 0.5


@dataclass
class _Place:
    """A window's reference: its number and luma (h, w) in 8 bits, 0 where invalid."""

    number: int
    luma: NDArray[np.uint8]


class Laps:
    """All references so far with small images of theirs, and what windows say about these alone."""

    def __init__(self, scale: WorkingScale) -> None:
        self.scale = scale
        self.places: list[_Place] = []
        self.windows: list[Window] = []
        self.returns = 0  # windows with frames of more than one visit

    def add(self, number: int, luma: F32, window: Window | None) -> None:
        """A reference, its luma (h, w) at the working size and its window over other references, if it has one."""
        known = np.nan_to_num(luma) * np.float32(255)
        self.places.append(_Place(number, np.clip(np.rint(known), 0, 255).astype(np.uint8)))
        if window is not None:
            self.windows.append(window)

    def look(self, pose: Callable[[int], Pose], depth: F32) -> bool:
        """Compare the newest reference with old ones that stood where it stands; True if some were recognised.

        pose: number -> T_wc; depth (H, W), radial, of the newest, NaN where unknown.
        """
        newest = self.places[-1]
        T_wr = pose(newest.number)
        old = self._stood_here(pose, T_wr, depth)
        if not old:
            return False
        s = self.scale
        small = cv2.resize(depth, s.valid.shape[::-1], interpolation=cv2.INTER_NEAREST)
        known = np.where(s.valid & np.isfinite(small), small, np.nan).astype(np.float32)
        levels = self._pyramid(newest)
        reference = make_reference(s.camera, levels[0], known, len(levels))
        recent = self.places[-1 - RECENT : -1]
        seen = [self._aligned(reference, p, invert_pose(pose(p.number)) @ T_wr) for p in [*recent, *old]]
        limit = COST_MAX * float(np.median([a.cost for a in seen[: len(recent)]]))
        good = [
            (p, a) for k, (p, a) in enumerate(zip([*recent, *old], seen))
            if k < len(recent) or (a.cost < limit and a.overlap > OVERLAP_MIN)
        ]  # fmt: skip
        if len(good) < len(recent) + 2:
            return False
        images = np.stack([self._luma(p) for p, _ in good])
        T_fr = np.stack([a.T_fr for _, a in good])
        bundle = refine(levels[0], s.rays, np.nan_to_num(known), images, T_fr, s.code, s.cam, OPTIONS)
        if bundle.ok:
            self.windows.append(Window(newest.number, np.array([p.number for p, _ in good]), bundle))
            self.returns += 1
        return bundle.ok

    def _stood_here(self, pose: Callable[[int], Pose], T_wr: Pose, depth: F32) -> list[_Place]:
        """Old references near ``T_wr``, by the median of what it sees, the nearest first."""
        newest = self.places[-1].number
        old = [p for p in self.places if p.number <= newest - OLD]
        if not old or not np.isfinite(depth).any():
            return []
        near = NEAR * float(np.nanmedian(depth))
        away = np.array([np.linalg.norm(pose(p.number)[:3, 3] - T_wr[:3, 3]) for p in old])
        return [old[k] for k in np.argsort(away, kind="stable")[:OLD_MOST] if away[k] < near]

    def _luma(self, place: _Place) -> F32:
        return np.where(self.scale.valid, place.luma / np.float32(255), np.float32(np.nan)).astype(np.float32)

    def _pyramid(self, place: _Place) -> list[F32]:
        return pyramid(self._luma(place))

    def _aligned(self, reference: Reference, place: _Place, T_fr: Pose) -> Alignment:
        return align(reference, self._pyramid(place), T_fr)

    def close(self, pose: Callable[[int], Pose], depth: float) -> dict[int, Pose]:
        """T_wc by number of all references, as suits all windows; none if the camera never came back."""
        if not self.returns:
            return {}
        numbers = np.array([p.number for p in self.places])  # ascending
        known = (reduced(w, np.isin(w.frames, numbers)) for w in self.windows)
        windows = [
            Window(int(np.searchsorted(numbers, w.reference)), np.searchsorted(numbers, w.frames), w.bundle)
            for w in known
            if w is not None
        ]
        before = np.stack([pose(int(n)) for n in numbers])
        prior = PosePrior(PRIOR_TRANSLATION * depth, PRIOR_ROTATION)
        after = fit_trajectory(before, windows, prior, np.arange(len(numbers)) < 1)
        return {int(n): T for n, T in zip(numbers, after)}

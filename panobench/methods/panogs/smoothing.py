"""Poses of the last frames from one another: a window of photometric bundle adjustment behind the tracker.

A pose found by aligning a frame to a rendered map falls short by up to a percent, because the map was fitted to other
views with its depth nearly fixed; new parts of the map inherit the lack, and the scale decays. Refining the poses of a
window jointly with the depths of its first frame's pixels has no such bias, but leaves the scale of each window free.
Consecutive windows overlap, so it is carried from one to the next by the frames both have refined, never by the map.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise
from panobench.methods.panogs.recent import RecentFrame
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale, resize_panorama

Pose = NDArray[np.float64]
#: More iterations change little (docs/panogs-lab.md).
OPTIONS = BundleOptions(cell_px=5, iterations=6)
#: Frames two windows must share for the scale to pass from one to the other.
SHARED_MIN = 4
#: A frame counts for the scale if it is at least this share of the window's length away.
FAR_ENOUGH = 0.5
#: No window may stretch more than this, either way: beyond, something else went wrong.
STRETCH_MAX = 1.25


class Smoother:
    """Refines windows of frames and remembers which frames have been refined."""

    def __init__(self, scale: WorkingScale) -> None:
        self.scale = scale
        self.settled: set[int] = set()

    def refine(
        self,
        target: RecentFrame,
        others: list[RecentFrame],
        pose: Callable[[int], Pose],
        depth: F32,
        first_stretch: float,
    ) -> dict[int, Pose]:
        """New T_wc of ``others`` by frame number; that of ``target`` stays.

        pose: frame number -> T_wc; depth (h, w): of the target, radial. It should be swept with these poses: from a
        map with a wrong surface the refinement does not find the right one. first_stretch: the factor on the window's
        scale while no frames are settled.
        """
        T_wc = pose(target.index)
        before = np.stack([invert_pose(pose(f.index)) @ T_wc for f in others])
        images = np.stack([f.fine for f in others])
        s = self.scale
        known = resize_panorama(depth, s.valid.shape, s.camera.kind == "erp")
        known = np.where(s.valid & np.isfinite(known), known, 0).astype(np.float32)
        bundle = refine(target.fine, s.rays, known, images, before, s.code, s.cam, OPTIONS)
        if not bundle.ok:
            return {}
        after = bundle.T_fr.copy()
        lengths = np.linalg.norm(before[:, :3, 3], axis=1), np.linalg.norm(after[:, :3, 3], axis=1)
        after[:, :3, 3] *= self._stretch(others, *lengths) if self.settled else first_stretch
        self.keep(others)
        return {f.index: renormalise(T_wc @ invert_pose(T)) for f, T in zip(others, after)}

    def keep(self, others: list[RecentFrame]) -> None:
        """These frames have the poses they should."""
        self.settled |= {f.index for f in others}

    def _stretch(self, others: list[RecentFrame], before: Pose, after: Pose) -> float:
        """The factor that gives the window the scale its settled frames have had."""
        shared = np.array([f.index in self.settled for f in others]) & (after > 0)
        if np.count_nonzero(shared) < SHARED_MIN:
            return 1.0
        shared &= after >= FAR_ENOUGH * after[shared].max()
        return float(np.clip(np.median(before[shared] / after[shared]), 1 / STRETCH_MAX, STRETCH_MAX))

"""Fixed-lag smoothing: poses of the last frames from one another, by photometric bundle adjustment behind the tracker.

A pose found by aligning a frame to a rendered map falls short by up to a percent, because the map was fitted to other
views with its depth nearly fixed. New parts of the map inherit the error, and the scale decays. Refining the poses of a
lag jointly with the depths of its first frame's pixels has no such bias, but leaves the scale of each lag free.
Consecutive lags overlap, so the scale passes from one to the next through the frames that both have refined, never
through the map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise
from panobench.methods.panogs.config import FixedLagOptions
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame
from panobench.methods.panogs.trajectory import AnchoredTrajectory, Correction
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale, resize_panorama

Pose = NDArray[np.float64]
#: More iterations change little (docs/panogs-lab.md).
BUNDLE = BundleOptions(cell_px=5, iterations=6)


class LagSmoother:
    """Refines the frames of one lag and remembers which frames have been refined."""

    def __init__(self, scale: WorkingScale, options: FixedLagOptions) -> None:
        self.scale, self.options = scale, options
        self.refined: set[int] = set()

    def refine(
        self,
        target: BufferedFrame,
        others: list[BufferedFrame],
        trajectory: AnchoredTrajectory,
        depth_map: F32,
        first_stretch: float,
    ) -> Correction:
        """New poses of ``others``; that of ``target`` stays.

        depth_map (h, w): radial depth of the target. It should be swept with these poses: from a map with a wrong
        surface the refinement does not find the right one. first_stretch: factor on the lag's scale while no frames
        have been refined.
        """
        T_wc = trajectory[target.index]
        before = trajectory.relative(target.index, [f.index for f in others])
        images = np.stack([f.fine for f in others])
        s = self.scale
        known = resize_panorama(depth_map, s.valid.shape, s.camera.kind == "erp")
        known = np.where(s.valid & np.isfinite(known), known, 0).astype(np.float32)
        bundle = refine(target.fine, s.rays, known, images, before, s.code, s.cam, BUNDLE)
        if not bundle.ok:
            return Correction({})
        after = bundle.T_fr.copy()
        lengths = np.linalg.norm(before[:, :3, 3], axis=1), np.linalg.norm(after[:, :3, 3], axis=1)
        after[:, :3, 3] *= self._stretch(others, *lengths) if self.refined else first_stretch
        self.mark_refined(others)
        return Correction({f.index: renormalise(T_wc @ invert_pose(T)) for f, T in zip(others, after)})

    def mark_refined(self, frames: list[BufferedFrame]) -> None:
        """The poses of these frames carry the scale from here on."""
        self.refined |= {f.index for f in frames}

    def _stretch(self, others: list[BufferedFrame], before: Pose, after: Pose) -> float:
        """The factor that gives the lag the scale of its frames that were refined before. before, after (F,)."""
        shared = np.array([f.index in self.refined for f in others]) & (after > 0)
        if np.count_nonzero(shared) < self.options.shared_min:
            return 1.0
        shared &= after >= self.options.shared_far * after[shared].max()
        limit = self.options.stretch_max
        return float(np.clip(np.median(before[shared] / after[shared]), 1 / limit, limit))

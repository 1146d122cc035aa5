"""Loop factors from revisits: places the camera comes back to tie the whole trajectory together.

A bundle-adjustment factor does not care when its frames were taken. Where the camera returns, the reference is compared
with old references that stood there long before; this ties the visits together at one scale. At the end the trajectory
that minimises all factors' costs is solved for, over references only: the frames between them follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.methods.panogs.config import RevisitOptions
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.photometric.align import Alignment, align
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pose_factors import BundleFactor, PosePrior, marginalise, optimise_trajectory
from panobench.photometric.pyramid import F32, pyramid
from panobench.photometric.reference import Reference, make_reference
from panobench.photometric.stereo import WorkingScale

Pose = NDArray[np.float64]
#: One pixel in 5 x 5, at half the size of other factors.
BUNDLE = BundleOptions(cell_px=5, iterations=6, cut=5.0)


@dataclass
class _Reference:
    """A factor's reference: its number, its frame's index and luma (h, w) in 8 bits, 0 where invalid."""

    number: int
    index: int
    luma: NDArray[np.uint8]


class RevisitFactors:
    """All references so far with small images of theirs, and the factors over these alone."""

    def __init__(self, scale: WorkingScale, options: RevisitOptions) -> None:
        self.scale, self.options = scale, options
        self.references: list[_Reference] = []
        self.factors: list[BundleFactor] = []
        self.revisits = 0  # factors over frames of more than one visit

    def add(self, number: int, index: int, luma: F32, factor: BundleFactor | None) -> None:
        """A reference, its luma (h, w) at the working size and its factor over other references, if it has one."""
        known = np.nan_to_num(luma) * np.float32(255)
        self.references.append(_Reference(number, index, np.clip(np.rint(known), 0, 255).astype(np.uint8)))
        if factor is not None:
            self.factors.append(factor)

    def look(self, trajectory: AnchoredTrajectory, depth_map: F32) -> bool:
        """Compare the newest reference with old ones where it stands; True if some were recognised.

        depth_map (H, W): radial depth of the newest, NaN where unknown.
        """
        newest, s = self.references[-1], self.scale
        T_wr = trajectory[newest.index]
        old = self._old_nearby(trajectory, T_wr, depth_map)
        if not old:
            return False
        small = cv2.resize(depth_map, s.valid.shape[::-1], interpolation=cv2.INTER_NEAREST)
        known = np.where(s.valid & np.isfinite(small), small, np.nan).astype(np.float32)
        levels = self._pyramid(newest)
        reference = make_reference(s.camera, levels[0], known, len(levels))
        recent = self.references[-1 - self.options.recent : -1]
        aligned = [self._align(reference, r, invert_pose(trajectory[r.index]) @ T_wr) for r in [*recent, *old]]
        good = self._good(recent, old, aligned)
        if len(good) < len(recent) + 2:
            return False
        images = np.stack([self._luma(r) for r, _ in good])
        T_fr = np.stack([a.T_fr for _, a in good])
        bundle = refine(levels[0], s.rays, np.nan_to_num(known), images, T_fr, s.code, s.cam, BUNDLE)
        if bundle.ok:
            self.factors.append(BundleFactor(newest.number, np.array([r.number for r, _ in good]), bundle))
            self.revisits += 1
        return bundle.ok

    def _good(
        self, recent: list[_Reference], old: list[_Reference], aligned: list[Alignment]
    ) -> list[tuple[_Reference, Alignment]]:
        """All recent references, and the old ones that are seen as well as these are."""
        o = self.options
        limit = o.cost_max * float(np.median([a.cost for a in aligned[: len(recent)]]))
        pairs = list(zip([*recent, *old], aligned))
        seen = [(r, a) for r, a in pairs[len(recent) :] if a.cost < limit and a.overlap > o.overlap_min]
        return pairs[: len(recent)] + seen

    def _old_nearby(self, trajectory: AnchoredTrajectory, T_wr: Pose, depth_map: F32) -> list[_Reference]:
        """Old references near ``T_wr``, in units of the median of what it sees, the nearest first."""
        o, newest = self.options, self.references[-1].number
        old = [r for r in self.references if r.number <= newest - o.old]
        if not old or not np.isfinite(depth_map).any():
            return []
        near = o.near * float(np.nanmedian(depth_map))
        away = np.array([np.linalg.norm(trajectory[r.index][:3, 3] - T_wr[:3, 3]) for r in old])
        return [old[k] for k in np.argsort(away, kind="stable")[: o.old_most] if away[k] < near]

    def _luma(self, reference: _Reference) -> F32:
        value = reference.luma / np.float32(255)
        return np.where(self.scale.valid, value, np.float32(np.nan)).astype(np.float32)

    def _pyramid(self, reference: _Reference) -> list[F32]:
        return pyramid(self._luma(reference))

    def _align(self, reference: Reference, other: _Reference, T_fr: Pose) -> Alignment:
        return align(reference, self._pyramid(other), T_fr)

    def optimise(self, trajectory: AnchoredTrajectory, scene_depth: float) -> dict[int, Pose]:
        """T_wc by frame index of all references, minimising all costs; empty if the camera never came back."""
        if not self.revisits:
            return {}
        o, numbers = self.options, np.array([r.number for r in self.references])  # ascending
        known = (marginalise(f, np.isin(f.frames, numbers)) for f in self.factors)
        factors = [
            BundleFactor(int(np.searchsorted(numbers, f.reference)), np.searchsorted(numbers, f.frames), f.bundle)
            for f in known
            if f is not None
        ]
        before = np.stack([trajectory[r.index] for r in self.references])
        prior = PosePrior(o.prior_translation * scene_depth, o.prior_rotation)
        after = optimise_trajectory(before, factors, prior, np.arange(len(numbers)) < 1)
        return {r.index: T for r, T in zip(self.references, after)}

"""Bundle-adjustment factors around every few frames, and the trajectory that minimises their costs.

A pose found by aligning a frame to a rendered map is off by what the map is off by, and so are its neighbours'. Frames
that are compared with one another, each reference with those up to a second before and after it, do not know the map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose
from panobench.methods.panogs.config import FactorOptions
from panobench.methods.panogs.factor_graph.depth import FactorDepth
from panobench.methods.panogs.factor_graph.revisits import RevisitFactors
from panobench.methods.panogs.rigs.scale import RigScale
from panobench.methods.panogs.trajectory import AnchoredTrajectory, Correction
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pose_factors import BundleFactor, log_scale, marginalise, optimise_trajectory
from panobench.photometric.pose_prior import PosePrior
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale

#: Poses are good when they come: few iterations. Depths need not be: the nearest frames first, the worst pixels out.
#: In narrow views depth and motion are told apart by few pixels, and by the far frames: all of both are needed.
BUNDLE = {
    ViewWidth.WIDE: BundleOptions(cell_px=6, iterations=4, cut=5.0, trim=0.6, near=12),
    ViewWidth.NARROW: BundleOptions(cell_px=8, iterations=5, cut=5.0),
}
#: The pixels that fit worst may be those that tell how far the lenses of a rig are apart: none is left out.
RIG_BUNDLE = replace(BUNDLE[ViewWidth.WIDE], iterations=10, trim=0.0)
#: Cells are not smaller than this where part of a wide view is hidden, pixels.
SMALLEST_CELL = 3
#: So many frames on either side are near enough, wherever they are.
NEAREST = 4


def bundle_options(scale: WorkingScale, width: ViewWidth, rig: bool = False) -> BundleOptions:
    """Options of the factors of a camera's view: smaller cells, by the share that is seen, where a mask hides part of
    a wide view. What is left determines poses worse than its share of the pixels tells.
    """
    options = RIG_BUNDLE if rig else BUNDLE[width]
    if width is not ViewWidth.WIDE:
        return options
    return replace(options, cell_px=max(int(options.cell_px * seen_share(scale)), SMALLEST_CELL))


def seen_share(scale: WorkingScale) -> float:
    """Share of the pixels that no mask hides, of those that the camera has."""
    return float(scale.valid.sum()) / max(float(scale.camera.with_mask(None).valid_mask().sum()), 1.0)


def softened(luma: F32) -> F32:
    """Luma (h, w) of a panorama without its finest detail, NaN also beside NaN.

    Between pixels an image is interpolated, which is off by what its slope changes within a pixel: by most at the
    sharp edges that pixels are selected on.
    """
    padded = np.concatenate([luma[:, -1:], luma, luma[:, :1]], axis=1)
    return np.ascontiguousarray(cv2.GaussianBlur(padded, (3, 3), 0)[:, 1:-1])


@dataclass
class _Frame:
    """luma (h, w): None once no factor needs it. depth_map: what its factor was made with, much smaller."""

    index: int
    luma: F32 | None
    depth_map: F32 | None = None


#: A frame that a reference is compared with: its number, its index in the sequence and its luma (h, w).
_Other = tuple[int, int, F32]


class FactorGraph:
    """Frames that moved are numbered in order; the images of the first and of the last ones are kept."""

    def __init__(
        self,
        scale: WorkingScale,
        width: ViewWidth,
        options: FactorOptions,
        revisits: RevisitFactors | None = None,
        rig_scale: RigScale | None = None,
    ) -> None:
        self.scale, self.options, self.revisits, self.rig_scale = scale, options, revisits, rig_scale
        self.bundle_options = bundle_options(scale, width, rig_scale is not None)
        #: Where a mask hides part of a wide view, what is left has to tell poses all the more exactly: images are
        #: softened, and the depth of references is swept.
        self.softens = width is ViewWidth.WIDE and rig_scale is None and seen_share(scale) < 1
        self.depth = FactorDepth(scale) if self.softens else None
        self.frames: list[_Frame] = []
        self.factors: list[BundleFactor] = []
        self.changed = False  # a factor has come since the last optimisation
        self._next, self._renew, self._reversed = 0, 0, False

    def add(self, index: int, luma: F32) -> None:
        """A frame by its index in the sequence, luma (h, w) at the working size."""
        o = self.options
        if not o.enabled:
            return
        self.frames.append(_Frame(index, self._soft(luma)))
        old = len(self.frames) - 1 - o.renew_after - o.reach - o.every - o.late
        if old > o.reach + 1:  # the very first are needed again if frames before them are tracked (``reverse``)
            self.frames[old - 1].luma = None

    def adopt(self, other: FactorGraph) -> None:
        """Go on from the frames of another graph that are newer than these. Their factors are made anew."""
        newest = self.frames[-1].index if self.frames else -1
        self.frames += [_Frame(f.index, f.luma) for f in other.frames if f.index > newest]

    def replace_luma(self, index: int, luma: F32) -> None:
        """Another luma (h, w) of a frame, by its index in the sequence; nothing if it is not here."""
        frame = next((f for f in reversed(self.frames) if f.index == index), None)
        if frame is not None:
            frame.luma = self._soft(luma)

    def _soft(self, luma: F32) -> F32:
        return softened(luma) if self.softens else luma

    def reverse(self) -> None:
        """The next frames go on from the first one, backwards in time."""
        last = len(self.frames) - 1
        self.frames.reverse()
        self.factors = [BundleFactor(last - f.reference, last - f.frames, f.bundle) for f in self.factors]
        self._next = self._renew = max(last, 0)
        self._reversed = True

    # -- factors -----------------------------------------------------------------------------------------------------

    def due(self, *, at_end: bool = False) -> int | None:
        """Number of the frame whose factor should be made: ``reach`` frames have followed it, or none will follow."""
        count, o = len(self.frames), self.options
        if self._next < count - (1 if at_end else o.reach):
            return self._next
        if self._renew < min(count - (1 if at_end else o.renew_after), self._next):
            return self._renew
        return None

    def overdue(self) -> bool:
        """The factor that is due has been for ``late`` frames."""
        count, o = len(self.frames), self.options
        return self._next < count - o.reach - o.late or self._renew < min(count - o.renew_after - o.late, self._next)

    def make_factor(self, k: int, trajectory: AnchoredTrajectory, depth_map: F32) -> None:
        """The factor of frame ``k``, which is due. depth_map (H, W): its radial depth, NaN where unknown.

        The second time it is made again only if the depth has changed much; then it is final, and revisits are looked
        for.
        """
        s, o, again, target = self.scale, self.options, k != self._next, self.frames[k]
        if again:
            self._renew += o.every
        else:
            self._next += o.every
        if target.luma is None:
            return
        known = cv2.resize(depth_map, s.valid.shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.float32)
        known = np.where(s.valid & np.isfinite(known), known, 0).astype(np.float32)
        others = self._others(k)
        if self.depth is not None and others:
            T_fr = trajectory.relative(target.index, [index for _, index, _ in others])
            known = self.depth.sweep(target.luma, [luma for _, _, luma in others], T_fr, known)
        sample = known[:: max(known.shape[0] // 32, 1), :: max(known.shape[1] // 64, 1)]
        if not again or self._depth_changed(target.depth_map, sample):
            target.depth_map = sample.copy()
            self._make(k, known, others, trajectory)
        if again and self.revisits is not None and not self._reversed:
            factor = next((f for f in self.factors if f.reference == k), None)
            small = factor and marginalise(factor, (factor.frames - k) % o.every == 0)
            self.revisits.add(k, target.index, self.revisits.scale.halved(target.luma), small)
            self.revisits.look(trajectory, depth_map)

    def _others(self, k: int) -> list[_Other]:
        """The frames within reach of frame ``k`` whose images are kept, by number, index and luma."""
        first, last = max(k - self.options.reach, 0), min(k + self.options.reach, len(self.frames) - 1)
        near = [(n, self.frames[n]) for n in range(first, last + 1) if n != k]
        return [(n, f.index, f.luma) for n, f in near if f.luma is not None]

    def _make(self, k: int, known: F32, others: list[_Other], trajectory: AnchoredTrajectory) -> None:
        """known (h, w): depth of frame ``k`` at the working size, 0 where unknown."""
        s, target = self.scale, self.frames[k]
        if target.luma is None or not others:
            return
        T_fr = trajectory.relative(target.index, [index for _, index, _ in others])
        if self.rig_scale is not None:
            depth = float(np.median(known[known > 0])) if (known > 0).any() else 1.0
            close = np.linalg.norm(T_fr[:, :3, 3], axis=1) <= self.options.rig_reach * depth
            close |= np.array([abs(n - k) <= NEAREST for n, _, _ in others])
            others, T_fr = [o for o, is_close in zip(others, close) if is_close], T_fr[close]
            if not others:
                return
        images = np.stack([luma for _, _, luma in others])
        bundle = refine(target.luma, s.rays, known, images, T_fr, s.code, s.cam, self.bundle_options)
        if bundle.ok:
            factor = BundleFactor(k, np.array([n for n, _, _ in others]), bundle)
            self.factors = [f for f in self.factors if f.reference != k] + [factor]
            self.changed = True
            if self.rig_scale is not None and bundle.units is not None:
                self.rig_scale.add(target.index, bundle.units)

    def _depth_changed(self, before: F32 | None, after: F32) -> bool:
        """By ``renew_change`` or more, for the median pixel that is known in both."""
        if before is None:
            return True
        both = (before > 0) & (after > 0)
        if not both.any():
            return False
        return float(np.median(np.abs(np.log(after[both] / before[both])))) > self.options.renew_change

    # -- the trajectory ----------------------------------------------------------------------------------------------

    def optimise(self, trajectory: AnchoredTrajectory, scene_depth: float) -> Correction:
        """Poses of the last ``free`` frames that minimise all factors' costs; older ones stay."""
        self.changed = False
        o, count = self.options, len(self.frames)
        free = max(count - o.free, 1)
        self.factors = [f for f in self.factors if max(f.reference, f.frames.max()) >= free]
        if not self.factors:
            return Correction({})
        lo = min(min(f.reference, int(f.frames.min())) for f in self.factors)
        indices = [f.index for f in self.frames[lo:]]
        before = np.stack([trajectory[i] for i in indices])
        factors = [BundleFactor(f.reference - lo, f.frames - lo, f.bundle) for f in self.factors]
        prior = PosePrior(o.prior_translation * scene_depth, o.prior_rotation, o.prior_bend * scene_depth)
        units = self.rig_scale.held() if self.rig_scale is not None else None
        after = optimise_trajectory(before, factors, prior, np.arange(lo, count) < free, lens_units=units)
        # Noise in the poses before would pass for length; those after have little.
        shrunk = [log_scale(_relative(after, f), _relative(before, f)) for f in factors]
        if self.rig_scale is not None:
            for f in factors:
                if f.bundle.units is not None:
                    grown = float(np.exp(log_scale(f.bundle.T_fr, _relative(after, f))))
                    self.rig_scale.add(indices[f.reference], f.bundle.units, grown)
        poses, stretch = dict(zip(indices, after)), float(np.exp(-np.mean(shrunk)))
        if self._reversed:  # those before do not come first in the order of tracking, and must not follow
            poses |= {f.index: trajectory[f.index] for f in self.frames[:lo]}
        return Correction(poses, True, dict.fromkeys(indices[max(free - lo, 0) :], stretch))

    @property
    def drifted(self) -> bool:
        """A place was recognised that the poses so far have elsewhere."""
        return self.revisits is not None and self.revisits.drifted

    def optimise_with_revisits(self, trajectory: AnchoredTrajectory, scene_depth: float) -> Correction:
        """Poses of all references that minimise the costs of all factors there were, if the camera came back."""
        if self.revisits is None or self._reversed:
            return Correction({})
        if self.rig_scale is None:
            return self.revisits.optimise(trajectory, scene_depth)
        correction = self.revisits.optimise(trajectory, scene_depth, self.rig_scale.held())
        self.rig_scale.follow(correction.stretch)
        return correction


def _relative(T_wc: NDArray[np.float64], factor: BundleFactor) -> NDArray[np.float64]:
    """T_fr (F, 4, 4) of a factor's frames from the poses (N, 4, 4) of all."""
    return invert_pose(T_wc[factor.frames]) @ T_wc[factor.reference]

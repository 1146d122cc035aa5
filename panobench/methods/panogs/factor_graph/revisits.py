"""Loop factors from revisits: places the camera comes back to tie the whole trajectory together.

A bundle-adjustment factor does not care when its frames were taken. Where the camera returns, the reference is compared
with old references that stood there long before; this ties the visits together at one scale. The trajectory that
minimises all factors' costs is solved for over references only, and the frames between them follow: at once where a
place is recognised that the poses so far have elsewhere, and at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import distances_along, invert_pose, renormalise
from panobench.methods.panogs.config import RevisitOptions
from panobench.methods.panogs.factor_graph.recognition import Recogniser, Way, drift_of
from panobench.methods.panogs.trajectory import AnchoredTrajectory, Correction
from panobench.photometric.align import Alignment, align
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pose_factors import BundleFactor, LensUnits, marginalise, optimise_trajectory
from panobench.photometric.pose_prior import PosePrior
from panobench.photometric.pyramid import F32, pyramid
from panobench.photometric.reference import AlignOptions, Reference, make_reference
from panobench.photometric.stereo import WorkingScale

Pose = NDArray[np.float64]
#: One pixel in 5 x 5, at half the size of other factors.
BUNDLE = BundleOptions(cell_px=5, iterations=6, cut=5.0)
#: A loop moves poses far: more steps than the fit of the last frames needs.
ITERATIONS = 20


#: A place that was left long ago may have been exposed otherwise.
EXPOSED = AlignOptions(exposure=True)
#: Alignment finds places as far from each other as this, in depths.
REACH = 1.0
#: References on either side between which a correction's change of length is measured.
AROUND = 3


@dataclass
class _Reference:
    """A factor's reference: its number, its frame's index and luma (h, w) in 8 bits, 0 where invalid."""

    number: int
    index: int
    luma: NDArray[np.uint8]


@dataclass(frozen=True)
class _View:
    """What the newest reference sees: luma and radial depth (h, w), NaN where unknown, and both made to align to."""

    luma: F32
    depth_map: F32
    reference: Reference

    @property
    def depth(self) -> float:
        """The median."""
        return float(np.nanmedian(self.depth_map))


@dataclass(frozen=True)
class _Seen:
    """A reference that was aligned to the newest. place: in the list. luma (h, w): at the newest's exposure. start: its
    pose T_fr (4, 4) by the poses so far. drifted: it is elsewhere.
    """

    place: int
    luma: F32
    start: Pose
    alignment: Alignment
    drifted: bool = False


@dataclass(frozen=True)
class _Places:
    """Old references by their place in the list.

    near: those near the newest, the nearest first. possible (N,): those that may be, if the poses have drifted by the
    most that is believed of them, ``drift`` (N,).
    """

    near: list[int]
    possible: NDArray[np.bool_]
    drift: NDArray[np.float64]

    def __bool__(self) -> bool:
        return bool(self.near) or bool(self.possible.any())


class RevisitFactors:
    """All references so far with small images of theirs, and the factors over these alone.

    revisits: how many factors have frames of more than one visit. drifted: one of them contradicts the poses so far.
    """

    def __init__(self, scale: WorkingScale, options: RevisitOptions) -> None:
        self.scale, self.options = scale, options
        self.references: list[_Reference] = []
        self.factors: list[BundleFactor] = []
        self.recogniser, self.way = Recogniser(scale, options), Way()
        self.revisits, self.drifted = 0, False

    def add(self, number: int, index: int, luma: F32, factor: BundleFactor | None) -> None:
        """A reference, its luma (h, w) at the working size and its factor over other references, if it has one."""
        known = np.nan_to_num(luma) * np.float32(255)
        self.references.append(_Reference(number, index, np.clip(np.rint(known), 0, 255).astype(np.uint8)))
        self.recogniser.add(luma)
        if factor is not None:
            self.factors.append(factor)

    def look(self, trajectory: AnchoredTrajectory, depth_map: F32) -> bool:
        """Compare the newest reference with old ones where it stands, or that look like it; True if it knows some.

        depth_map (H, W): radial depth of the newest, NaN where unknown.
        """
        s, newest = self.scale, self.references[-1]
        small = cv2.resize(depth_map, s.valid.shape[::-1], interpolation=cv2.INTER_NEAREST)
        known = np.where(s.valid & np.isfinite(small), small, np.nan).astype(np.float32)
        places = self._places(trajectory, known)
        if not places:
            return False
        levels = self._pyramid(newest)
        view = _View(levels[0], known, make_reference(s.camera, levels[0], known, len(levels)))
        last = len(self.references) - 1
        recent = [self._align(view, n, trajectory) for n in range(max(last - self.options.recent, 0), last)]
        seen = self._nearby(view, recent, trajectory, places.near)
        if len(seen) < 2:
            seen = self._alike(view, trajectory, places)
        recent = [one for one in recent if self._is_right(view, one)]
        if len(seen) < 2 or not recent:
            return False
        T_fr = np.stack([one.alignment.T_fr for one in [*recent, *seen]])
        images = np.stack([one.luma for one in [*recent, *seen]])
        bundle = refine(levels[0], s.rays, np.nan_to_num(known), images, T_fr, s.code, s.cam, BUNDLE)
        if bundle.ok:
            numbers = [self.references[one.place].number for one in [*recent, *seen]]
            self.factors.append(BundleFactor(newest.number, np.array(numbers), bundle))
            self.way.ties += [(one.place, last) for one in seen]
            self.drifted |= any(one.drifted for one in seen)
            self.revisits += 1
        return bundle.ok

    def _places(self, trajectory: AnchoredTrajectory, depth_map: F32) -> _Places:
        """Where to look. depth_map (h, w): of the newest, NaN where unknown."""
        o, numbers = self.options, np.array([r.number for r in self.references])
        old = numbers <= numbers[-1] - o.old
        if not old.any() or not np.isfinite(depth_map).any():
            return _Places([], np.zeros(len(old), bool), np.zeros(len(old)))
        depth = float(np.nanmedian(depth_map))
        positions = np.stack([trajectory[r.index][:3, 3] for r in self.references])
        away = np.where(old, np.linalg.norm(positions - positions[-1], axis=1), np.inf)
        near = [int(n) for n in np.argsort(away, kind="stable")[: o.old_most] if away[n] < o.near * depth]
        drift = o.near * depth + o.drift_max * self.way.lengths(positions)
        return _Places(near, (away < drift + REACH * depth) & (o.alike > 0), drift)

    def _nearby(self, view: _View, recent: list[_Seen], trajectory: AnchoredTrajectory, near: list[int]) -> list[_Seen]:
        """Those of the references near the newest that are seen as well as recent ones are."""
        o = self.options
        limit = o.cost_max * float(np.median([one.alignment.cost for one in recent]))
        seen = [self._align(view, n, trajectory) for n in near]
        seen = [one for one in seen if one.alignment.cost < limit and one.alignment.overlap > o.overlap_min]
        return [one for one in seen if self._is_right(view, one)]

    def _alike(self, view: _View, trajectory: AnchoredTrajectory, places: _Places) -> list[_Seen]:
        """References that look like the newest and are not farther from where they should be than may be."""
        near, seen = self.options.near * view.depth, []
        for n in self.recogniser.alike(places.possible):
            levels, start = self._pyramid(self.references[n]), self._relative(n, trajectory)
            turned = start.copy()
            turned[:3, 3] = 0.0
            a = align(view.reference, levels, turned, EXPOSED)
            luma, drift = (levels[0] - np.float32(a.offset)) * np.float32(np.exp(-a.gain)), drift_of(start, a)
            one = _Seen(n, luma, start, a, drift > near)
            if drift < places.drift[n] and self._is_right(view, one):
                seen.append(one)
        return seen

    def _is_right(self, view: _View, seen: _Seen) -> bool:
        """Whether an alignment shows the other reference to be of the same place."""
        return self.recogniser.is_right(view.luma, view.depth_map, seen.luma, seen.start, seen.alignment)

    def _relative(self, place: int, trajectory: AnchoredTrajectory) -> Pose:
        """T_fr (4, 4) from the newest to another reference, by the poses so far."""
        return np.asarray(trajectory.relative(self.references[-1].index, [self.references[place].index])[0])

    def _luma(self, reference: _Reference) -> F32:
        value = reference.luma / np.float32(255)
        return np.where(self.scale.valid, value, np.float32(np.nan)).astype(np.float32)

    def _pyramid(self, reference: _Reference) -> list[F32]:
        return pyramid(self._luma(reference))

    def _align(self, view: _View, place: int, trajectory: AnchoredTrajectory) -> _Seen:
        """To the newest, from where the poses so far have it."""
        levels, start = self._pyramid(self.references[place]), self._relative(place, trajectory)
        return _Seen(place, levels[0], start, align(view.reference, levels, start))

    # -- the trajectory ----------------------------------------------------------------------------------------------

    def optimise(
        self, trajectory: AnchoredTrajectory, scene_depth: float, lens_units: LensUnits | None = None
    ) -> Correction:
        """Poses that minimise the costs of all factors over references; none if the camera never came back.

        Frames between references follow the one before them, at the scale of the way to the next one.
        """
        self.drifted = False
        if not self.revisits:
            return Correction({})
        o, numbers = self.options, np.array([r.number for r in self.references])  # ascending
        known = (marginalise(f, np.isin(f.frames, numbers)) for f in self.factors)
        factors = [
            BundleFactor(int(np.searchsorted(numbers, f.reference)), np.searchsorted(numbers, f.frames), f.bundle)
            for f in known
            if f is not None
        ]
        indices = [r.index for r in self.references]
        before = np.stack([trajectory[i] for i in indices])
        prior = PosePrior(o.prior_translation * scene_depth, o.prior_rotation)
        held = np.arange(len(numbers)) < 1
        after = optimise_trajectory(before, factors, prior, held, ITERATIONS, lens_units)
        return between(trajectory, indices, before, after)


def between(trajectory: AnchoredTrajectory, indices: list[int], before: Pose, after: Pose) -> Correction:
    """The correction of all frames from that of references ``indices``, T_wc (N, 4, 4) before and after.

    A frame stays where it was relative to the reference before it, its distance stretched as distances between the
    references around it are.
    """
    stretch = stretches(before[:, :3, 3], after[:, :3, 3])
    poses, grown, at = {}, {}, -1
    number = {index: n for n, index in enumerate(indices)}
    for index in trajectory:
        at = number.get(index, at)
        if at < 0:
            continue
        relative = invert_pose(before[at]) @ trajectory[index]
        relative[:3, 3] *= stretch[at]
        poses[index], grown[index] = renormalise(after[at] @ relative), float(stretch[at])
    return Correction(poses, True, grown)


def stretches(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,): by which the way around each of N positions (N, 3) has grown, over a few of them on either side."""
    ways = [distances_along(p) for p in (before, after)]
    n = np.arange(len(before))
    lo, hi = np.maximum(n - AROUND, 0), np.minimum(n + AROUND, len(before) - 1)
    own, new = (way[hi] - way[lo] for way in ways)
    return np.where((own > 0) & (new > 0), new / np.maximum(own, 1e-12), 1.0)

"""How large the map of a rig is: the lenses' distances tell it, each bundle adjustment a little.

The map keeps its own unit during the run. What changes is how many of these units the lenses are thought to be apart,
which is all that rendering and alignment need to know; only at the end trajectory and map are moved into metres. Where
the map's own scale drifts, the bundles measure another number of units there; the fit of the trajectory pulls it back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from panobench.cameras.rig_panorama import LensCentres
from panobench.depth.bootstrap_solve import SWEEP
from panobench.geometry import invert_pose
from panobench.methods.lens_scale import BIAS_PX
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pose_factors import LensUnits
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale, multi_view_depth, resize_panorama
from panobench.types import DepthEstimate

#: Rounds of adjusting the first frames, measuring the lenses' distances and sweeping depth: each depends on the others.
ROUNDS = 3
START = BundleOptions(iterations=10, cut=5.0, trim=0.3)


class RigScale:
    """Owns ``LensCentres.units_per_metre``. Measurements are by the index of the frame whose bundle made them.

    overlap: how many bundles a frame is in.
    """

    def __init__(self, lenses: LensCentres, overlap: float, log: Callable[[str], None]) -> None:
        self.lenses, self.overlap, self.log = lenses, overlap, log
        self.measured: dict[int, tuple[float, float]] = {}

    def add(self, index: int, units: tuple[float, float], grown: float = 1.0) -> None:
        """The units in a metre with their deviation, as a bundle has them; it has ``grown`` by a factor since."""
        mean, sigma = units
        if np.isfinite(sigma) and sigma > 0:
            self.measured[index] = (grown * mean, grown * sigma)
            self.lenses.units_per_metre = max(self._mean(), 0.0)

    def follow(self, stretch: Mapping[int, float]) -> None:
        """Distances around frames, by their index, have grown by these factors."""
        for index in self.measured.keys() & stretch.keys():
            self.add(index, self.measured[index], stretch[index])

    def held(self) -> LensUnits | None:
        """What the scale is held at all along the trajectory; None as long as nothing tells it.

        A frame's noise is in all the bundles that it is in. What scatters more than their deviations say has other
        reasons, which count as well.
        """
        mean = self.lenses.units_per_metre
        if mean <= 0:
            return None
        u, s = np.array(list(self.measured.values())).T
        excess = float(np.sqrt(np.mean(((u - mean) / s) ** 2)))
        return LensUnits(mean, float(np.sqrt(self.overlap)) * max(excess, 1.0))

    def _mean(self) -> float:
        u, s = np.array(list(self.measured.values())).T
        return float(np.sum(u / s**2) / np.sum(1 / s**2))

    def sigma(self, pixel_angle: float, scene_depth: float) -> float:
        """Standard deviation of the scale as a share of it; infinite where nothing tells it.

        pixel_angle: radians; scene_depth: the usual distance of what is seen, in the map's unit.
        """
        mean = self.lenses.units_per_metre
        if not self.measured or mean <= 0:
            return float("inf")
        u, s = np.array(list(self.measured.values())).T
        w = 1 / s**2
        alone = max(len(u) / self.overlap, 1.0)  # bundles that share no frames
        white = np.sqrt(len(u) / alone / w.sum())
        scatter = np.sqrt(np.sum(w * (u - mean) ** 2) / w.sum() / alone)
        centres = self.lenses.centres_m
        reach = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
        bias = BIAS_PX * pixel_angle * scene_depth / max(reach * mean, 1e-12)
        return float(np.hypot(max(white, scatter) / mean, bias))

    def start(self, estimate: DepthEstimate, lumas: dict[int, F32], scale: WorkingScale) -> DepthEstimate:
        """The first depth and its frames' poses as the rig saw them, which measures the lenses' distances.

        estimate: made as if there were one centre. lumas: of its frames, (h, w) at ``scale``, by index.
        """
        first = estimate.frame_index
        others = [i for i in lumas if i != first and i in estimate.T_wc]
        if len(others) < 3:
            return estimate
        T = np.stack([invert_pose(estimate.T_wc[i]) @ estimate.T_wc[first] for i in others])
        images, size = np.stack([lumas[i] for i in others]), estimate.depth.shape
        depth = resize_panorama(estimate.depth, scale.valid.shape, True)
        low, high = np.percentile(depth[scale.valid & np.isfinite(depth)], [0.5, 99.5])
        for _ in range(ROUNDS):
            known = np.where(scale.valid & np.isfinite(depth), depth, 0).astype(np.float32)
            bundle = refine(lumas[first], scale.rays, known, images, T, scale.code, scale.cam, START)
            if not bundle.ok or bundle.units is None:
                return estimate
            T = bundle.T_fr
            self.add(first, bundle.units)
            depth, confidence = multi_view_depth(
                lumas[first], scale, images, T, 0.7 * float(low), 1.4 * float(high), SWEEP
            )
        mean, sigma = self.measured[first]
        self.log(f"rig: by the first {len(lumas)} frames a metre is {mean:.3f} +- {sigma:.3f} units of the map")
        poses = {first: np.eye(4)} | {i: invert_pose(T_fr) for i, T_fr in zip(others, T)}
        return replace(
            estimate,
            depth=resize_panorama(depth, size, True),
            confidence=resize_panorama(np.where(scale.valid, confidence, 0).astype(np.float32), size, True),
            T_wc={**estimate.T_wc, **poses},
        )

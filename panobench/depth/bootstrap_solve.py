"""Joint depth of a reference frame and poses of the frames after it, from initial poses.

Plane sweeps, direct alignment and bundle adjustment alternate, first at a coarse, then at a finer width. The scale is
free.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import distances_along, invert_pose, renormalise
from panobench.photometric.align import align, mean_cost
from panobench.photometric.bundle import refine
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import AlignOptions, Reference, make_reference, reject_moving
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama
from panobench.photometric.sweep import reprojection_error
from panobench.photometric.warp import camera_code

Pose = NDArray[np.float64]
#: The scale is chosen so that the reference frame has this median radial depth.
MEDIAN_DEPTH = 2.0
#: The first depth is found only once, so its sweep has more depth hypotheses than later ones. Where one half of the
#: frames matches better than all of them, it decides (the other half may be occluded).
SWEEP = SweepOptions(shells=64, half_ratio=1.0, half_margin=0.002)
#: Residual (images in 0..1) from which the cost is linear when alignments are compared.
HUBER = 0.05
#: Least share of the reference's view that a frame must see to be used.
OVERLAP_MIN = 0.35


@dataclass(frozen=True)
class SolveOptions:
    """coarse_width, fine_width: the two working widths in pixels. frames: most frames used in a sweep. rounds,
    fine_rounds: sweeps at each width. near, far: ends of the sweep's range, in median depths.
    """

    coarse_width: int = 256
    fine_width: int = 512
    frames: int = 14
    rounds: int = 2
    fine_rounds: int = 1
    near: float = 0.2
    far: float = 15.0
    sweep: SweepOptions = field(default_factory=lambda: SWEEP)


@dataclass
class Solution:
    """depth, confidence: (H, W) at the fine working width, without NaN. T_fr: for each frame, the pose that takes
    points from the reference (the first frame) to it. used: the frames that took part in the sweep.
    """

    depth: F32
    confidence: F32
    T_fr: list[Pose]
    used: NDArray[np.intp]


def spread_over_path(T_fr: list[Pose], most: int) -> NDArray[np.intp]:
    """At most ``most`` frames after the first, evenly spaced along the path: rotating frames show no depth."""
    centres = np.stack([-T[:3, :3].T @ T[:3, 3] for T in T_fr])
    along = distances_along(centres)
    n = len(T_fr)
    if n - 1 <= most or along[-1] <= 0:
        return np.unique(np.linspace(1, n - 1, min(most, n - 1)).round().astype(np.intp))
    wanted = np.linspace(along[-1] / most, along[-1], most)
    nearest = np.abs(along[None, 1:] - wanted[:, None]).argmin(axis=1)
    return np.unique(nearest + 1).astype(np.intp)


class Solver:
    """Solves for depth and poses with one camera."""

    def __init__(self, camera: Camera, options: SolveOptions) -> None:
        self.options, self.wrap = options, camera.kind == "erp"
        self.code = camera_code(camera)[0]
        self.coarse = WorkingScale.of(camera, options.coarse_width)
        self.fine = WorkingScale.of(camera, options.fine_width)
        self.align_options = reject_moving(camera, AlignOptions(exposure=True))

    def reference(self, levels: list[F32], depth: F32, scale: WorkingScale) -> Reference:
        """The reference for alignment. ``levels`` is the frame's whole pyramid, ``depth`` (H, W) is at ``scale``."""
        masked = np.where(scale.valid, depth, np.nan).astype(np.float32)
        levels = levels[scale.level :]
        return make_reference(scale.camera, levels[0], masked, len(levels), self.align_options)

    def flat(self, levels: list[F32]) -> Reference:
        """The reference before its depth is known: the median depth everywhere."""
        return self.reference(levels, np.full(self.coarse.valid.shape, MEDIAN_DEPTH, np.float32), self.coarse)

    def solve(self, pyramids: list[list[F32]], T_fr: list[Pose], used: NDArray[np.intp]) -> Solution:
        """pyramids: one per frame, the reference's first. T_fr: initial poses. used: frames to sweep, at least one."""
        o, T_fr = self.options, [T.copy() for T in T_fr]
        near, far, scale = o.near, o.far, self.coarse
        depth = np.full(scale.valid.shape, MEDIAN_DEPTH, np.float32)
        confidence = np.zeros_like(depth)
        for round_ in range(o.rounds + o.fine_rounds):
            if round_ == o.rounds:
                depth = resize_panorama(depth, self.fine.valid.shape, self.wrap)
                scale = self.fine
                self._bundle(pyramids, T_fr, used, depth, scale)
            depth, confidence = self.sweep(pyramids, T_fr, used, (near, far), scale)
            factor = MEDIAN_DEPTH / float(np.median(depth[scale.valid]))
            depth *= np.float32(factor)
            for T in T_fr:
                T[:3, 3] *= factor
            reference = self.reference(pyramids[0], depth, scale)
            for k in range(1, len(T_fr)):
                T_fr[k] = align(reference, pyramids[k][scale.level :], T_fr[k], self.align_options).T_fr
            if round_ < o.rounds:
                self._bundle(pyramids, T_fr, used, depth, scale)
            if round_ >= 1:  # the coarse shape is known: narrow the range to the depths that occur
                low, high = np.percentile(depth[scale.valid], [0.5, 99.5]) / MEDIAN_DEPTH
                near, far = max(0.7 * float(low), o.near), min(1.4 * float(high), o.far)
        return Solution(depth, confidence, T_fr, used)

    def backwards(self, before: list[list[F32]], after: list[list[F32]], solution: Solution) -> list[Pose]:
        """Poses of the frames before the reference, newest first, as far back as they can be aligned to it.

        before: their pyramids, newest first. after: the pyramids of the reference and the frames after it.
        """
        scale, found = self.fine, [solution.T_fr[1], solution.T_fr[0]]
        reference = self.reference(after[0], solution.depth, scale)

        def aligned(levels: list[F32], T_fr: Pose) -> tuple[Pose, float, float]:
            a = align(reference, levels[scale.level :], T_fr, self.align_options)
            return a.T_fr, *mean_cost(reference, levels[scale.level :], a, HUBER)

        usual = float(np.median([aligned(after[k], solution.T_fr[k])[1] for k in solution.used]))
        for levels in before:
            T, cost, seen = aligned(levels, renormalise(found[-1] @ invert_pose(found[-2]) @ found[-1]))
            if seen < OVERLAP_MIN or not cost < 2 * usual:
                break
            found.append(T)
        return found[2:]

    def sweep(
        self,
        pyramids: list[list[F32]],
        T_fr: list[Pose],
        used: NDArray[np.intp],
        between: tuple[float, float],
        scale: WorkingScale,
        options: SweepOptions | None = None,
    ) -> tuple[F32, F32]:
        """Depth and confidence (H, W) from the frames ``used``; ``between`` is the range in median depths."""
        near, far = between[0] * MEDIAN_DEPTH, between[1] * MEDIAN_DEPTH
        T = np.stack([T_fr[k] for k in used])
        luma, images = pyramids[0][scale.level], _images(pyramids, used, scale)
        return multi_view_depth(luma, scale, images, T, near, far, options or self.options.sweep)

    def seen(
        self, pyramids: list[list[F32]], T_fr: list[Pose], by: NDArray[np.intp], depth: F32, scale: WorkingScale
    ) -> NDArray[np.bool_]:
        """(H, W): the pixels that at least one of the frames ``by`` sees, at depth (H, W)."""
        T, out = np.stack([T_fr[k] for k in by]).astype(np.float32), np.empty_like(depth)
        R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
        luma, images = pyramids[0][scale.level], _images(pyramids, by, scale)
        reprojection_error(luma, scale.rays, images, R, t, depth, scale.code, scale.cam, np.float32(1), out)
        return np.isfinite(out) & scale.valid

    def _bundle(
        self, pyramids: list[list[F32]], T_fr: list[Pose], used: NDArray[np.intp], depth: F32, scale: WorkingScale
    ) -> None:
        """Bundle adjustment of depth and the poses of the frames ``used``. Alignment moves the others later."""
        T = np.stack([T_fr[k] for k in used])
        images = _images(pyramids, used, scale)
        bundle = refine(pyramids[0][scale.level], scale.rays, depth, images, T, self.code, scale.cam)
        for k, pose in zip(used, bundle.T_fr):
            T_fr[k] = pose


def _images(pyramids: list[list[F32]], used: NDArray[np.intp], scale: WorkingScale) -> F32:
    return np.stack([pyramids[k][scale.level] for k in used])

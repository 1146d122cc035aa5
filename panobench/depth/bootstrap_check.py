"""Checks of a first depth against the images alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from panobench.depth.bootstrap_solve import HUBER, MEDIAN_DEPTH, Pose, Solution, Solver
from panobench.geometry import so3_log
from panobench.photometric.align import align, mean_cost
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import AlignOptions

#: Residual from which the cost is linear when two solutions are compared.
FINE_HUBER = 0.02
#: The cost with depth may be at most this share of the cost of a pure rotation, which needs no depth.
EXPLAINED_MAX = 0.7
#: Early and late frames must find the same depth, to AGREE in its logarithm, in this share of the confident pixels.
AGREEMENT_MIN, AGREE = 0.82, 0.15
#: With less than that, but more than this, a second method can confirm the solution: where people move through the
#: view, or the sky is white, many pixels have no depth, and the poses may be right all the same.
CONFIRMABLE_MIN = 0.5
#: It does if its positions, after Sim(3) alignment, are within this share of their spread about their mean, and its
#: rotations within so many radians (RMS, both).
CONFIRMED_MAX, CONFIRMED_RAD = 0.06, 0.01
#: Depth hypotheses of the two sweeps that find out.
CHECK_SHELLS = 40
#: Least ratio of the 90th to the 10th percentile of depth.
SPREAD_MIN = 1.05
#: Largest share of the view whose depth may lie at an end of the search range.
PEGGED_MAX = 0.4


@dataclass(frozen=True)
class SolutionCheck:
    """unexplained: photometric cost with depth over that of the best pure rotation. agreement: share of the confident
    pixels in which the early and the late half of the frames find the same depth. spread: 90th over 10th percentile
    of depth. pegged: share of the view whose depth lies at an end of the search range.
    """

    unexplained: float
    agreement: float
    spread: float
    pegged: float

    @property
    def confirmable(self) -> bool:
        """Whether nothing is wrong, or nothing but an agreement that is somewhat too low."""
        return replace(self, agreement=math.inf).problem() is None and self.agreement > CONFIRMABLE_MIN

    def problem(self) -> str | None:
        """What is wrong, in one line, or None."""
        if not self.unexplained < EXPLAINED_MAX:
            cost = f"{100 * self.unexplained:.0f}% of the cost"
            return f"its depth explains the images hardly better than a rotation ({cost})"
        if not self.agreement > AGREEMENT_MIN:
            return f"early and late frames agree on only {100 * self.agreement:.0f}% of its depth"
        if not self.spread > SPREAD_MIN:
            return "its depth is the same everywhere"
        if self.pegged > PEGGED_MAX:
            return f"{100 * self.pegged:.0f}% of its depth lies at the end of the range"
        return None


def check_solution(solver: Solver, pyramids: list[list[F32]], solution: Solution) -> SolutionCheck:
    """Check a solution. ``pyramids`` are those of the reference and the frames after it, as for ``Solver.solve``."""
    valid = solver.fine.valid
    depth = solution.depth[valid]
    low, high = np.percentile(depth, [10, 90])
    pegged = float(
        ((depth < 1.1 * solver.options.near * MEDIAN_DEPTH) | (depth > 0.9 * solver.options.far * MEDIAN_DEPTH)).mean()
    )
    return SolutionCheck(
        _unexplained(solver, pyramids, solution), _agreement(solver, pyramids, solution), float(high / low), pegged
    )


@dataclass(frozen=True)
class Comparison:
    """Two methods' poses of the same frames: RMS distance over spread, RMS angle in radians, how many frames."""

    distance: float
    angle: float
    frames: int

    @property
    def confirms(self) -> bool:
        return self.frames >= 6 and self.distance < CONFIRMED_MAX and self.angle < CONFIRMED_RAD

    def __str__(self) -> str:
        return f"{100 * self.distance:.1f}% and {np.rad2deg(self.angle):.2f} deg apart over {self.frames} frames"


def compare_poses(a: Mapping[int, Pose], b: Mapping[int, Pose]) -> Comparison:
    """Poses T_wc by frame, each in its own world and scale, after Sim(3) alignment."""
    common = sorted(set(a) & set(b))
    if len(common) < 3:
        return Comparison(float("inf"), float("inf"), len(common))
    T_a, T_b = (np.stack([poses[i] for i in common]) for poses in (a, b))
    p, q = T_a[:, :3, 3], T_b[:, :3, 3]
    spread = np.sqrt(((q - q.mean(axis=0)) ** 2).sum(axis=1).mean())
    if not spread > 0:
        return Comparison(float("inf"), float("inf"), len(common))
    # The worlds' rotation comes from the camera's rotations: a straight path leaves the turn about itself open.
    relative = T_b[:, :3, :3] @ T_a[:, :3, :3].transpose(0, 2, 1)
    u, _, vt = np.linalg.svd(relative.sum(axis=0))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    angles = np.linalg.norm(so3_log(R.T @ relative), axis=-1)
    p, q = (p - p.mean(axis=0)) @ R.T, q - q.mean(axis=0)
    scale = float((p * q).sum()) / max(float((p * p).sum()), 1e-12)
    distance = np.sqrt(((scale * p - q) ** 2).sum(axis=1).mean()) / spread
    return Comparison(float(distance), float(np.sqrt((angles**2).mean())), len(common))


def _unexplained(solver: Solver, pyramids: list[list[F32]], solution: Solution) -> float:
    """Measured at the coarse size, over the three used frames that are farthest from the reference."""
    scale = solver.coarse
    small = resize_down(solution.depth, scale.valid.shape)
    reference = solver.reference(pyramids[0], small, scale)
    rotation_only = replace(solver.align_options, rotation_only=True)
    away = [float(np.linalg.norm(solution.T_fr[k][:3, 3])) for k in solution.used]
    with_depth, without = 0.0, 0.0
    for k in solution.used[np.argsort(away)[-3:]]:
        frame, T = pyramids[k][scale.level :], solution.T_fr[k]
        with_depth += _cost(solver, reference, frame, T, solver.align_options)
        T_rotation = T.copy()
        T_rotation[:3, 3] = 0
        without += _cost(solver, reference, frame, T_rotation, rotation_only)
    return with_depth / max(without, 1e-9)


def photometric_cost(solver: Solver, pyramids: list[list[F32]], solution: Solution) -> float:
    """Mean robust cost at the fine size over the used frames. It compares solutions of the same frames."""
    scale = solver.fine
    reference = solver.reference(pyramids[0], solution.depth, scale)
    costs = []
    for k in solution.used:
        frame = pyramids[k][scale.level :]
        found = align(reference, frame, solution.T_fr[k], solver.align_options, coarsest=0)
        costs.append(mean_cost(reference, frame, found, FINE_HUBER)[0])
    return float(np.mean(costs))


def _cost(solver: Solver, reference, frame: list[F32], T_fr: Pose, options: AlignOptions) -> float:  # type: ignore[no-untyped-def]
    return mean_cost(reference, frame, align(reference, frame, T_fr, options), HUBER)[0]


def _agreement(solver: Solver, pyramids: list[list[F32]], solution: Solution) -> float:
    """Measured at the coarse size, in the more confident half of what both see. 1 with too few frames to tell."""
    used, scale = solution.used, solver.coarse
    if len(used) < 4:
        return 1.0
    whole = replace(solver.options.sweep, half_min=len(used) + 1, shells=CHECK_SHELLS)
    low, high = np.percentile(solution.depth[solver.fine.valid], [0.5, 99.5]) / MEDIAN_DEPTH
    between = (0.7 * float(low), 1.4 * float(high))
    halves = np.array_split(used, 2)
    (early, confidence_early), (late, confidence_late) = (
        solver.sweep(pyramids, solution.T_fr, half, between, scale, whole) for half in halves
    )
    both = np.logical_and(*(solver.seen(pyramids, solution.T_fr, half, early, scale) for half in halves))
    if not both.any():
        return 0.0
    confidence = np.minimum(confidence_early, confidence_late)
    both &= confidence >= np.median(confidence[both])
    return float((np.abs(np.log(early / late)) < AGREE)[both].mean())


def resize_down(depth: F32, shape: tuple[int, ...]) -> F32:
    """Depth (H, W) reduced to ``shape`` by taking every n-th pixel."""
    step = depth.shape[1] // shape[1]
    return np.ascontiguousarray(depth[step // 2 :: step, step // 2 :: step][: shape[0], : shape[1]])

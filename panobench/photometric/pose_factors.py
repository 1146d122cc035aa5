"""Poses of a whole trajectory from bundle-adjustment factors that overlap.

A factor is what is left of one reference's bundle adjustment once the depths are marginalised: the poses of the frames
around it, a quadratic cost around them, and a scale of its own. Every frame is in several factors, and the trajectory
minimises the sum of their costs. There are few unknowns, so it is solved for in milliseconds however many pixels stand
behind it. A weak prior on the poses as they were joins parts that no factor ties together (``pose_prior``). What the
lenses of a rig tell of the scale is one more residual of each factor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve

from panobench.geometry import hat, invert_pose, renormalise, se3_exp, se3_log
from panobench.photometric.bundle import Bundle
from panobench.photometric.pose_prior import HeldPoses, PosePrior

Array = NDArray[np.float64]

#: More where the prior is robust, whose weights follow the poses.
ITERATIONS, REWEIGHED_ITERATIONS = 4, 6
#: Poses from which the normal equations are kept sparse: they have blocks along the diagonal, and some for loops.
MANY = 200
#: A step that changes nothing by more than this, in standard deviations of the prior, is the last one.
CONVERGED = 1e-3
#: Shares of itself that are added to the diagonal of a system that is not positive definite, one after the other.
DAMPING = (0.0, 1e-6, 1e-3, 0.1)


@dataclass(frozen=True)
class BundleFactor:
    """reference: number of a frame. frames (F,): numbers of the others, in the order of ``bundle``."""

    reference: int
    frames: NDArray[np.int64]
    bundle: Bundle


@dataclass(frozen=True)
class LensUnits:
    """The units of a rig's map in a metre, which each factor has measured for itself (``Bundle.units``).

    inflation: by which the factors' standard deviations are too small.
    """

    units: float
    inflation: float = 1.0


def optimise_trajectory(
    T_wc: Array,
    factors: list[BundleFactor],
    prior: PosePrior,
    held: NDArray[np.bool_],
    iterations: int | None = None,
    lens_units: LensUnits | None = None,
) -> Array:
    """Poses (N, 4, 4) that minimise the factors' costs; those ``held`` (N,) stay. T_wc (N, 4, 4): start and prior.

    Frames are numbered from 0 to N - 1. Gauss-Newton on left twists of T_cw; the prior keeps the system regular.
    lens_units: of a rig, which holds the scale around every reference.
    """
    count, poses = len(T_wc), HeldPoses(T_wc, prior)
    T_cw = poses.before.copy()
    free = np.flatnonzero(np.repeat(~held, 6))
    solve_for = _step_sparse if count > MANY else _step
    if iterations is None:
        iterations = ITERATIONS if prior.bend is None else REWEIGHED_ITERATIONS
    for iteration in range(iterations if len(free) else 0):
        if iteration:
            poses.reweigh(T_cw)
        b, bend = poses.gradient(T_cw), poses.bend(T_cw)
        parts = [] if bend is None else [bend]
        for factor in factors:
            A, g = _linearise(factor, T_cw, lens_units)
            cells = (6 * np.append(factor.frames, factor.reference)[:, None] + np.arange(6)).ravel()
            parts.append((cells, A))
            b[cells] += g
        step = solve_for(poses.unit, parts, -b[free], free)
        if step is None:
            break
        x = np.zeros(6 * count)
        x[free] = step
        T_cw = renormalise(se3_exp(x.reshape(count, 6)) @ T_cw)
        if np.abs(x * np.sqrt(poses.unit)).max() < CONVERGED:
            break
    return invert_pose(T_cw)


#: A factor's cells (6F + 6,) in the system, and its part of it (6F + 6, 6F + 6).
_Part = tuple[NDArray[np.int64], Array]


def _step(unit: Array, parts: list[_Part], b: Array, free: NDArray[np.int64]) -> Array | None:
    """The Gauss-Newton step of the ``free`` unknowns; None if there are no finite numbers.

    unit: the prior's diagonal. b: the right-hand side, of the free unknowns alone.
    """
    place = np.full(len(unit), -1)
    place[free] = np.arange(len(free))
    H = np.diag(unit[free])
    for cells, A in parts:
        moves = place[cells] >= 0
        at = place[cells[moves]]
        H[at[:, None], at] += A[np.ix_(moves, moves)]
    return _solved(H, b)


def _step_sparse(unit: Array, parts: list[_Part], b: Array, free: NDArray[np.int64]) -> Array | None:
    """The same for many poses."""
    if not np.isfinite(b).all():
        return None
    rows = np.concatenate([np.repeat(cells, len(cells)) for cells, _ in parts])
    columns = np.concatenate([np.tile(cells, len(cells)) for cells, _ in parts])
    values = np.concatenate([A.ravel() for _, A in parts])
    H = (coo_matrix((values, (rows, columns)), (len(unit), len(unit))) + diags(unit)).tocsr()[free][:, free]
    for damping in DAMPING:
        step = np.asarray(spsolve((H + damping * diags(np.abs(H.diagonal()))).tocsc(), b))
        if np.isfinite(step).all() and float(step @ b) > 0:  # downhill, as of a positive definite system
            return step
    return None


def _solved(H: Array, b: Array) -> Array | None:
    """x with H x = b, H (n, n) symmetric; None if there are no finite numbers.

    Rounding in the Schur complements can leave H slightly indefinite: then its diagonal is raised as far as it takes.
    """
    if not (np.isfinite(H).all() and np.isfinite(b).all()):
        return None
    for damping in DAMPING:
        try:
            damped = H + damping * np.diag(np.abs(np.diag(H)))
            factor = cho_factor(damped, overwrite_a=True, check_finite=False)
            return np.asarray(cho_solve(factor, b, check_finite=False))
        except LinAlgError:
            continue
    return None


def marginalise(factor: BundleFactor, keep: NDArray[np.bool_]) -> BundleFactor | None:
    """The factor over the frames to ``keep`` (F,), the others marginalised (Schur complement); None if none is kept."""
    if not keep.any():
        return None
    b = factor.bundle
    kept, gone = (np.repeat(mask, 6) for mask in (keep, ~keep))
    H, g = b.information, b.gradient
    across = H[np.ix_(kept, gone)]
    Hgg = H[np.ix_(gone, gone)]
    Hgg = Hgg + 1e-9 * np.trace(Hgg) / max(len(Hgg), 1) * np.eye(len(Hgg))
    solved = np.linalg.solve(Hgg, np.column_stack([across.T, g[gone]]))
    A, rest = H[np.ix_(kept, kept)] - across @ solved[:, :-1], g[kept] - across @ solved[:, -1]
    bundle = replace(b, T_fr=b.T_fr[keep], information=0.5 * (A + A.T), gradient=rest)
    return BundleFactor(factor.reference, factor.frames[keep], bundle)


def log_scale(own: Array, now: Array) -> float:
    """Log of the factor that takes the translations of poses ``own`` (F, 4, 4) to those of ``now``, least squares."""
    a, b = own[:, :3, 3], now[:, :3, 3]
    return float(np.log(max((a * b).sum(), 1e-18) / max((a**2).sum(), 1e-18)))


def _linearise(factor: BundleFactor, T_cw: Array, lens_units: LensUnits | None) -> tuple[Array, Array]:
    """H (6F + 6, 6F + 6) and b over the twists of a factor's frames and then of its reference.

    The residual is in the factor's own unit, at the scale its translations have in the trajectory. That scale must be
    a function of the poses and be differentiated with them: were it fixed, a smaller trajectory would lower every
    cost; were it free, a factor out of all proportion would fit anything.
    """
    bundle, F = factor.bundle, len(factor.frames)
    T_fr = T_cw[factor.frames] @ invert_pose(T_cw[factor.reference])
    own, scale = bundle.T_fr, log_scale(bundle.T_fr, T_fr)
    measured = own.copy()
    measured[:, :3, 3] *= np.exp(scale)
    S = np.tile(np.repeat([np.exp(-scale), 1.0], 3), F)
    e = se3_log(T_fr @ invert_pose(measured)).ravel() * S
    lengths, by = np.zeros((F, 6)), np.zeros((F, 6))
    lengths[:, :3], by[:, :3] = T_fr[:, :3, 3], own[:, :3, 3]
    by /= max(float((own[:, :3, 3] * T_fr[:, :3, 3]).sum()), 1e-18)
    u, across = S * lengths.ravel(), -_adjoint(T_fr).reshape(6 * F, 6)
    # J = diag(S) (1 - lengths by^T) [1, across], multiplied out: it has no other full product.
    w = np.concatenate([by.ravel(), by.ravel() @ across])
    AS = bundle.information * S
    AJ = np.concatenate([AS, AS @ across], axis=1) - np.outer(bundle.information @ u, w)
    g = AJ.T @ e
    SAJ, Sg = S[:, None] * AJ, S * bundle.gradient
    H = np.concatenate([SAJ, across.T @ SAJ]) - np.outer(w, u @ AJ)
    g = g + np.concatenate([Sg, across.T @ Sg]) - w * (u @ bundle.gradient)
    if lens_units is not None and bundle.units is not None:
        # w is the derivative of ``scale``. What was measured is in the factor's own unit.
        believed, deviation = lens_units.units * np.exp(-scale), bundle.units[1] * lens_units.inflation
        H += np.outer(w, w) * (believed / deviation) ** 2
        g += w * (bundle.units[0] - believed) * believed / deviation**2
    return H, g


def _adjoint(T: Array) -> Array:
    """(F, 4, 4) -> (F, 6, 6): takes a twist (translation, rotation) through the pose."""
    R = T[:, :3, :3]
    A = np.zeros((len(T), 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = R
    A[:, :3, 3:] = hat(T[:, :3, 3]) @ R
    return A

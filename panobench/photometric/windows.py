"""Poses of a whole trajectory from windows of bundle adjustment that overlap.

A window is what is left of one reference's bundle adjustment: the poses of the frames around it, a quadratic around
them, and a scale of its own. Every frame is in several windows; the trajectory is what suits all of them best. With
the depths already eliminated there are few unknowns, so a trajectory is solved for in milliseconds however many
pixels stand behind it. A weak prior on the poses as they were joins parts that no window ties together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solveh_banded

from panobench.geometry import hat, invert_pose, renormalise, se3_exp, se3_log
from panobench.photometric.bundle import Bundle

Array = NDArray[np.float64]

ITERATIONS = 6
#: Largest change of a step, in units of the prior's standard deviations, after which nothing is left to do.
SETTLED = 1e-3


@dataclass(frozen=True)
class Window:
    """reference: number of a frame; frames (F,): numbers of the others, as in ``bundle``."""

    reference: int
    frames: NDArray[np.int64]
    bundle: Bundle


@dataclass(frozen=True)
class PosePrior:
    """Standard deviations of a pose as it was: translation (in the trajectory's unit), rotation (rad)."""

    translation: float
    rotation: float


def fit_trajectory(T_wc: Array, windows: list[Window], prior: PosePrior, held: NDArray[np.bool_]) -> Array:
    """Poses (N, 4, 4) that suit all ``windows``; those ``held`` (N,) stay. T_wc (N, 4, 4): start and prior.

    Frames are numbered in order of time, 0 to N - 1. Gauss-Newton on left twists of T_cw, a banded system.
    """
    count = len(T_wc)
    before = invert_pose(T_wc)
    T_cw = before.copy()
    reach = max((int(np.abs(w.frames - w.reference).max()) for w in windows), default=0)
    span = max((int(w.frames.max(initial=w.reference) - w.frames.min(initial=w.reference)) for w in windows), default=0)
    band = min(6 * (max(reach, span) + 1), 6 * count)
    unit = np.repeat([1.0 / prior.translation**2, 1.0 / prior.rotation**2], 3)
    for _ in range(ITERATIONS):
        H, b = np.zeros((band, 6 * count)), np.zeros(6 * count)
        for window in windows:
            A, g = _part(window, T_cw)
            cells = (6 * np.append(window.frames, window.reference)[:, None] + np.arange(6)).ravel()
            rows, columns = np.meshgrid(cells, cells, indexing="ij")
            lower = rows >= columns
            np.add.at(H, (rows[lower] - columns[lower], columns[lower]), A[lower])
            np.add.at(b, cells, g)
        off = se3_log(T_cw @ invert_pose(before))
        H[0] += np.tile(unit, count)
        b += (unit * off).ravel()
        _hold(H, b, np.repeat(held, 6))
        try:
            x = solveh_banded(H, -b, lower=True)
        except (LinAlgError, ValueError):
            break
        T_cw = renormalise(se3_exp(x.reshape(count, 6)) @ T_cw)
        if np.abs(x.reshape(count, 6) * np.sqrt(unit)).max() < SETTLED:
            break
    return invert_pose(T_cw)


def log_scale(own: Array, now: Array) -> float:
    """By what translations of poses ``own`` (F, 4, 4) must grow to be those of ``now``."""
    a, b = own[:, :3, 3], now[:, :3, 3]
    return float(np.log(max((a * b).sum(), 1e-18) / max((a**2).sum(), 1e-18)))


def _part(window: Window, T_cw: Array) -> tuple[Array, Array]:
    """H (6F + 6, 6F + 6) and b over the twists of a window's frames and then of its reference.

    The residual is the misfit in the window's own unit, at the scale its translations have in the trajectory. That
    scale must be a function of the poses, and be differentiated with them: were it fixed, a smaller trajectory would
    suit all windows better; were it free, a window out of all proportion would fit anything.
    """
    bundle, F = window.bundle, len(window.frames)
    T_fr = T_cw[window.frames] @ invert_pose(T_cw[window.reference])
    own, scale = bundle.T_fr, log_scale(bundle.T_fr, T_fr)
    measured = own.copy()
    measured[:, :3, 3] *= np.exp(scale)
    shrink = np.repeat([np.exp(-scale), 1.0], 3)
    e = (se3_log(T_fr @ invert_pose(measured)) * shrink).ravel()
    J = np.concatenate([np.eye(6 * F), -_adjoint(T_fr).reshape(6 * F, 6)], axis=1)
    lengths, by = np.zeros((F, 6)), np.zeros((F, 6))
    lengths[:, :3], by[:, :3] = T_fr[:, :3, 3], own[:, :3, 3]
    by /= max(float((own[:, :3, 3] * T_fr[:, :3, 3]).sum()), 1e-18)
    J -= np.outer(lengths, by.ravel() @ J)
    J *= np.tile(shrink, F)[:, None]
    AJ = bundle.information @ J
    return J.T @ AJ, AJ.T @ e + J.T @ bundle.gradient


def _adjoint(T: Array) -> Array:
    """(F, 4, 4) -> (F, 6, 6): takes a twist (translation, rotation) through the pose."""
    R = T[:, :3, :3]
    A = np.zeros((len(T), 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = R
    A[:, :3, 3:] = hat(T[:, :3, 3]) @ R
    return A


def _hold(H: Array, b: Array, held: NDArray[np.bool_]) -> None:
    """Take unknowns out of a banded system (lower form, H[i, j] = entry (j + i, j)): their steps are zero."""
    columns = np.arange(H.shape[1])
    for i in range(H.shape[0]):
        rows = np.minimum(columns + i, len(b) - 1)
        H[i, held | held[rows]] = 0.0
    H[0, held] = 1.0
    b[held] = 0.0

"""What holds poses where they were: its derivatives, and that it does not hold a length that a tracker got wrong."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from test_pose_factors import disturbed, factor, misfit, path

from panobench.geometry import invert_pose, se3_exp, se3_log
from panobench.photometric.pose_factors import optimise_trajectory
from panobench.photometric.pose_prior import LOOSEST, HeldPoses, PosePrior

Array = NDArray[np.float64]
BENDING = PosePrior(0.01, 0.01, bend=0.003)


def cost(poses: HeldPoses, T_cw: Array, bend: float) -> float:
    """As the docstrings say it, at the weights that the positions have now."""
    moved = invert_pose(T_cw)[:, :3, 3] - poses.positions
    twists = se3_log(T_cw @ invert_pose(poses.before)).ravel()
    return 0.5 * float((poses.unit * twists**2).sum() + (np.diff(moved, 2, axis=0) ** 2).sum() / bend**2)


def test_the_gradient_is_that_of_the_cost_and_so_is_the_curvature() -> None:
    before = path(7)
    poses = HeldPoses(before, BENDING)
    T_cw = invert_pose(disturbed(before, 1e-3))  # close to where they were: the twists' own curvature is left out
    poses.reweigh(T_cw)
    assert BENDING.bend is not None
    g, h = poses.gradient(T_cw), 1e-6
    numeric = np.empty_like(g)
    for k in range(len(g)):
        step = np.zeros(len(g))
        step[k] = h
        costs = [cost(poses, se3_exp((s * step).reshape(-1, 6)) @ T_cw, BENDING.bend) for s in (1, -1)]
        numeric[k] = (costs[0] - costs[1]) / (2 * h)
    np.testing.assert_allclose(g, numeric, atol=2e-3 * np.abs(g).max())

    found = poses.bend(T_cw)
    assert found is not None
    cells, information = found
    x = np.zeros(len(g))
    x[cells] = np.random.default_rng(0).normal(0, 1e-4, len(cells))
    moved = HeldPoses(before, BENDING)
    moved.unit = poses.unit
    change = moved.gradient(se3_exp(x.reshape(-1, 6)) @ T_cw) - g
    expected = poses.unit * x
    expected[cells] += information @ x[cells]
    np.testing.assert_allclose(change[cells], expected[cells], atol=2e-2 * np.abs(expected).max())


def short_steps(truth: Array, since: int, share: float) -> Array:
    """Poses whose steps have ``share`` of their length from frame ``since`` on."""
    T = truth.copy()
    steps = np.diff(truth[:, :3, 3], axis=0)
    steps[since:] *= share
    T[1:, :3, 3] = T[0, :3, 3] + np.cumsum(steps, axis=0)
    return T


def length_of(T: Array, frames: slice) -> float:
    """Of the way between the first and the last of these frames, as the crow flies."""
    ends = T[frames][[0, -1], :3, 3]
    return float(np.linalg.norm(ends[1] - ends[0]))


def test_steps_that_are_all_too_short_get_their_length_back() -> None:
    truth = path(60)
    start = short_steps(truth, 20, 0.8)
    factors = [factor(truth, k, 12) for k in range(0, 60, 6)]
    held, late = np.arange(60) < 12, slice(24, 60)
    robust = optimise_trajectory(start, factors, BENDING, held)
    plain = optimise_trajectory(start, factors, PosePrior(0.01, 0.01), held)
    shares = [length_of(T, late) / length_of(truth, late) for T in (start, plain, robust)]
    assert shares[0] == pytest.approx(0.8, abs=0.02)
    assert shares[1] < 0.82
    assert shares[2] > 0.9
    assert misfit(robust, truth) < 0.5 * misfit(plain, truth)


def test_noise_of_single_frames_is_not_followed() -> None:
    """A factor that is sure of itself and wrong moves a position far less than one that all its neighbours share."""
    before = path(30)
    wrong = before.copy()
    wrong[15, :3, 3] += [0.0, 0.05, 0.0]
    factors = [factor(wrong, 15, 4)]
    held = np.arange(30) == 0
    loose = optimise_trajectory(before, factors, PosePrior(0.1, 0.1), held)
    bending = optimise_trajectory(before, factors, PosePrior(0.1, 0.1, bend=0.002), held)
    jump = [np.linalg.norm(np.diff(T[:, :3, 3] - before[:, :3, 3], 2, axis=0), axis=1).max() for T in (loose, bending)]
    assert jump[0] > 0.05
    assert jump[1] < 0.3 * jump[0]


def test_frames_behind_the_last_factor_go_along() -> None:
    truth = path(40)
    start = short_steps(truth, 10, 0.8)
    factors = [factor(truth, k, 8) for k in range(0, 28, 4)]
    fitted = optimise_trajectory(start, factors, BENDING, np.arange(40) < 8)
    joint = np.linalg.norm(np.diff(fitted[30:, :3, 3] - start[30:, :3, 3], axis=0), axis=1)
    assert joint.max() < 0.05  # the correction, of some 0.4, does not end at once
    assert np.isfinite(fitted).all()


def test_what_moved_far_is_held_less_but_never_let_go() -> None:
    before = path(5)
    poses = HeldPoses(before, BENDING)
    full = 1.0 / BENDING.translation**2
    np.testing.assert_allclose(poses.unit.reshape(5, 6)[:, :3], full / LOOSEST**2)
    T = before.copy()
    T[:, 0, 3] += [0.0, 0.001, 0.01, 0.03, 10.0]
    poses.reweigh(invert_pose(T))
    np.testing.assert_allclose(
        poses.unit.reshape(5, 6)[:, 0], full * np.array([1.0, 1 / 1.01, 0.5, 0.1, 1 / LOOSEST**2]), rtol=1e-9
    )
    np.testing.assert_allclose(poses.unit.reshape(5, 6)[:, 3:], 1.0 / BENDING.rotation**2)

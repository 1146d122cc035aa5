"""Trajectories from overlapping bundle-adjustment factors: exact ones stay, disturbed ones are mended."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose, se3_exp, se3_log, umeyama
from panobench.photometric.bundle import Bundle, BundleOptions, refine
from panobench.photometric.pose_factors import BundleFactor, LensUnits, log_scale, optimise_trajectory
from panobench.photometric.pose_prior import PosePrior
from panobench.photometric.pyramid import luma_of_frame
from panobench.photometric.stereo import WorkingScale

Array = NDArray[np.float64]
LOOSE = PosePrior(1.0, 1.0)


def path(count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    T = np.stack([np.eye(4)] * count)
    for i in range(1, count):
        T[i] = T[i - 1] @ se3_exp(np.concatenate([[0.1, 0.0, 0.02], [0.0, 0.05, 0.0]]) + rng.normal(0, 0.02, 6))
    return T


def factor(T_wc: Array, reference: int, reach: int, scale: float = 1.0, seed: int = 0) -> BundleFactor:
    """What bundle adjustment of exact images would leave, at a scale of its own."""
    frames = np.array(
        [i for i in range(max(reference - reach, 0), min(reference + reach + 1, len(T_wc))) if i != reference]
    )
    T_fr = invert_pose(T_wc[frames]) @ T_wc[reference]
    T_fr[:, :3, 3] *= scale
    rng = np.random.default_rng(seed + reference)
    root = rng.normal(size=(6 * len(frames), 6 * len(frames)))
    A = 1e4 * (root @ root.T / len(root) + np.eye(len(root)))
    # Depths have been eliminated: a common scale of the translations costs nothing.
    free = np.concatenate([T_fr[:, :3, 3], np.zeros((len(frames), 3))], axis=1).ravel()
    P = np.eye(len(free)) - np.outer(free, free) / (free @ free)
    return BundleFactor(reference, frames, Bundle(T_fr, 0.0, P @ A @ P, np.zeros(len(free))))


def misfit(T: Array, truth: Array) -> float:
    s = umeyama(T[:, :3, 3], truth[:, :3, 3])
    return float(np.sqrt(((s.apply_points(T[:, :3, 3]) - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def disturbed(truth: Array, size: float, seed: int = 1) -> Array:
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, size, (len(truth), 6))
    noise[0] = 0.0
    return truth @ se3_exp(noise)


def test_exact_poses_stay() -> None:
    truth = path(20)
    held = np.arange(20) == 0
    fitted = optimise_trajectory(truth, [factor(truth, k, 6) for k in range(0, 20, 3)], LOOSE, held)
    assert np.abs(se3_log(invert_pose(truth) @ fitted)).max() < 1e-7


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.98, 1.03)], ids=["one scale", "a scale for each factor"])
def test_disturbed_poses_are_mended(scales: tuple[float, float]) -> None:
    truth = path(24)
    start = disturbed(truth, 0.01)
    factors = [factor(truth, k, 8, scales[i % 2]) for i, k in enumerate(range(0, 24, 4))]
    fitted = optimise_trajectory(start, factors, LOOSE, np.arange(24) == 0)
    assert misfit(start, truth) > 5e-3
    assert misfit(fitted, truth) < 2e-4
    np.testing.assert_allclose(fitted[0], start[0])


def drifting(truth: Array, rate: float) -> Array:
    """Poses whose steps shrink by ``rate`` from one to the next."""
    T = truth.copy()
    steps = np.diff(truth[:, :3, 3], axis=0) * np.exp(-rate * np.arange(len(truth) - 1))[:, None]
    T[1:, :3, 3] = T[0, :3, 3] + np.cumsum(steps, axis=0)
    return T


def test_the_lenses_of_a_rig_hold_the_scale_against_drift() -> None:
    truth = path(60)
    start = drifting(truth, 0.005)  # by 26% in all, which factors of unknown scale cannot tell
    factors = []
    for k in range(0, 60, 4):
        f = factor(start, k, 8)
        true_scale = float(np.exp(log_scale(f.bundle.T_fr, invert_pose(truth[f.frames]) @ truth[k])))
        factors.append(BundleFactor(k, f.frames, replace(f.bundle, units=(1 / true_scale, 0.01))))
    held, loose = np.arange(60) == 0, PosePrior(10.0, 10.0)
    free = optimise_trajectory(start, factors, loose, held)
    fitted = optimise_trajectory(start, factors, loose, held, lens_units=LensUnits(1.0))
    assert misfit(free, truth) > 0.05
    assert misfit(fitted, truth) < 0.2 * misfit(free, truth)  # within a factor the poses drift as well
    # Deviations that are said to be far too small do not outweigh the prior.
    unsure = optimise_trajectory(start, factors, PosePrior(0.01, 0.01), held, lens_units=LensUnits(1.0, 1e3))
    assert np.abs(unsure - start).max() < 1e-3


def test_held_frames_do_not_move() -> None:
    truth = path(24)
    start = disturbed(truth, 0.01)
    held = np.arange(24) < 10
    fitted = optimise_trajectory(start, [factor(truth, k, 8) for k in range(0, 24, 4)], LOOSE, held)
    np.testing.assert_allclose(fitted[held], start[held], atol=1e-12)
    assert np.abs(fitted[~held] - start[~held]).max() > 1e-3


def test_parts_that_no_factor_joins_stay_where_they_were() -> None:
    truth = path(30)
    start = disturbed(truth, 0.005)
    factors = [factor(truth[:15], k, 6) for k in (0, 5, 10)]
    second = [factor(truth[15:], k, 6) for k in (0, 5, 10)]
    late = [BundleFactor(f.reference + 15, f.frames + 15, f.bundle) for f in second]
    fitted = optimise_trajectory(start, [*factors, *late], PosePrior(0.01, 0.01), np.arange(30) == 0)
    assert misfit(fitted[15:], truth[15:]) < 0.3 * misfit(start[15:], truth[15:])
    assert np.linalg.norm((fitted[15:, :3, 3] - start[15:, :3, 3]).mean(axis=0)) < 5e-3


def test_growth_of_distances() -> None:
    T = path(5)
    grown = T.copy()
    grown[:, :3, 3] *= 1.07
    assert np.exp(log_scale(T, grown)) == pytest.approx(1.07)


@lru_cache(maxsize=1)
def real_factors() -> tuple[Array, Array, list[BundleFactor]]:
    """Truth, a start that is off, and factors of real images from the start and depth that is off, too."""
    sequence = RoomsDataset().open("tiny", width=256)
    assert sequence.groundtruth is not None
    count = 16
    truth = invert_pose(sequence.groundtruth.T_wc[0]) @ sequence.groundtruth.T_wc[:count]
    scale = WorkingScale.of(sequence.camera, 256)
    luma = np.stack([luma_of_frame(sequence.image(i), scale.valid) for i in range(count)])
    start = disturbed(truth, 0.003)
    factors = []
    for k in (0, 5, 10, 15):
        depth = sequence.depth(k)
        assert depth is not None
        depth = np.nan_to_num(depth * np.random.default_rng(k).normal(1.0, 0.02, depth.shape)).astype(np.float32)
        frames = np.array([i for i in range(count) if i != k])
        T_fr = invert_pose(start[frames]) @ start[k]
        options = BundleOptions(cell_px=4)
        bundle = refine(luma[k], scale.rays, depth, luma[frames], T_fr, scale.code, scale.cam, options)
        assert bundle.ok
        factors.append(BundleFactor(k, frames, bundle))
    return truth, start, factors


def test_factors_of_images_mend_a_trajectory() -> None:
    truth, start, factors = real_factors()
    fitted = optimise_trajectory(start, factors, PosePrior(0.02, 0.01), np.arange(len(truth)) == 0)
    assert misfit(fitted, truth) < 0.4 * misfit(start, truth)


def test_cost_of_a_factor_does_not_depend_on_its_scale() -> None:
    for f in real_factors()[2]:
        A, T = f.bundle.information, f.bundle.T_fr
        free = np.concatenate([T[:, :3, 3], np.zeros((len(T), 3))], axis=1).ravel()
        free /= np.linalg.norm(free)
        assert np.all(np.linalg.eigvalsh(A) > -1e-6 * np.trace(A) / len(A))
        assert free @ A @ free < 0.02 * np.trace(A) / len(A)


def test_a_system_that_rounding_left_indefinite_is_solved() -> None:
    truth = path(12)
    bad = factor(truth, 5, 5)
    values, vectors = np.linalg.eigh(bad.bundle.information)
    values[:3] = -2e-3 * values.max()  # more than the prior makes up for
    indefinite = Bundle(bad.bundle.T_fr, 0.0, (vectors * values) @ vectors.T, bad.bundle.gradient)
    factors = [BundleFactor(5, bad.frames, indefinite)]
    T = optimise_trajectory(disturbed(truth, 0.003), factors, LOOSE, np.arange(12) == 0)
    assert np.isfinite(T).all()
    assert misfit(T, truth) < 0.05


def test_poses_stay_where_a_factor_has_no_numbers() -> None:
    truth = path(12)
    bad = factor(truth, 5, 5)
    nothing = Bundle(bad.bundle.T_fr, 0.0, bad.bundle.information * np.nan, bad.bundle.gradient)
    T = optimise_trajectory(truth, [BundleFactor(5, bad.frames, nothing)], LOOSE, np.arange(12) == 0)
    np.testing.assert_allclose(T, truth, atol=1e-12)

"""sparse on a rig: bearings that begin at the lenses' centres, and the scale that follows from their distance."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.methods.sparse.absolute import pose_ransac
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.mapping import ray_distance
from panobench.methods.sparse.pointmap import ACTIVE, Keyframe, PointMap
from panobench.methods.sparse.pose import pose_errors, solve_pose
from panobench.methods.sparse.rig_faces import build_rig_faces
from panobench.methods.sparse.scale import adjust_scale, independent_sigma, is_due, scale_sigma, spread
from panobench.testing import two_lenses

FOCAL = 80.0


@pytest.fixture(scope="module")
def lenses() -> Lenses:
    return build_rig_faces(two_lenses(128, 0.1), 1_000_000, 3).lenses


def points(rng: np.random.Generator, count: int) -> np.ndarray:
    """In a room around the origin, one to three metres away."""
    X = rng.normal(size=(count, 3))
    return X / np.linalg.norm(X, axis=1, keepdims=True) * rng.uniform(1, 3, (count, 1))


def camera(k: int) -> np.ndarray:
    """T_cw of a rig that walks on a circle and turns."""
    a = 0.5 * k
    T_wc = make_pose(so3_exp([0.1 * np.sin(a), 0.9 * a, 0.0]), [0.5 * np.sin(a), 0.1 * np.cos(2 * a), 0.5 * np.cos(a)])
    return invert_pose(T_wc)


def seen(lenses: Lenses, T_cw: np.ndarray, X: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    b = lenses.bearings(X @ T_cw[:3, :3].T + T_cw[:3, 3]) + rng.normal(size=X.shape) * noise / FOCAL
    return b / np.linalg.norm(b, axis=1, keepdims=True)


def in_view(lenses: Lenses, T_cw: np.ndarray, X: np.ndarray) -> np.ndarray:
    return lenses.sees(X @ T_cw[:3, :3].T + T_cw[:3, 3])


def test_each_half_of_the_sphere_belongs_to_its_lens(lenses: Lenses) -> None:
    b = points(np.random.default_rng(0), 500)
    np.testing.assert_array_equal(lenses.of(b), (b[:, 2] < 0).astype(int))
    origins = lenses.origins(b)
    assert origins is not None
    np.testing.assert_allclose(origins[:, 2], np.where(b[:, 2] > 0, 0.05, -0.05), atol=1e-12)
    assert Lenses().origins(b) is None


def test_two_rays_meet_in_their_point_whatever_lens_saw_it(lenses: Lenses) -> None:
    rng = np.random.default_rng(1)
    X, first, second = points(rng, 200), camera(0), camera(4)
    X = X[in_view(lenses, first, X) & in_view(lenses, second, X)]
    b1, b2 = (seen(lenses, T, X, 0.0, rng) for T in (first, second))
    assert (lenses.of(b1) != lenses.of(b2)).any()
    relative = np.broadcast_to(second @ invert_pose(first), (len(X), 4, 4))
    distance, angle = ray_distance(b1, b2, relative[:, :3, :3], lenses.between(relative, b1, b2))
    good = angle > 0.02
    T_wc = np.broadcast_to(invert_pose(first), (len(X), 4, 4))
    np.testing.assert_allclose(lenses.places(T_wc, b1, distance)[good], X[good], atol=1e-6)


def test_the_pose_is_that_of_the_rig(lenses: Lenses) -> None:
    rng = np.random.default_rng(2)
    X, T = points(rng, 320), camera(3)
    X = X[in_view(lenses, T, X) & in_view(lenses, camera(9), X)][:300]
    b = seen(lenses, T, X, 0.0, rng)
    near = camera(2)
    found = solve_pose(near, X, b, FOCAL, 1.0, 30, lenses.origins(b))
    np.testing.assert_allclose(found, T, atol=1e-6)
    assert np.abs(solve_pose(near, X, b, FOCAL, 1.0, 30) - T).max() > 1e-3  # one centre is wrong
    wrong = rng.choice(len(X), 100, replace=False)
    mixed = b.copy()
    mixed[wrong] = seen(lenses, camera(9), X[wrong], 0.0, rng)
    answer = pose_ransac(X, mixed, FOCAL, rng, lenses=lenses)
    assert answer is not None
    np.testing.assert_allclose(answer[0], T, atol=1e-5)
    assert not answer[1][wrong].all()
    assert pose_errors(T, X, b, FOCAL, lenses.origins(b)).max() < 1e-4


def made_up_map(lenses: Lenses, seed: int, wrong_by: float, turning: bool = True, noise: float = 0.2) -> PointMap:
    """Keyframes and points of a walk; all but the observations ``wrong_by`` this factor."""
    rng = np.random.default_rng(seed)
    m = PointMap(1, lenses)
    X = points(rng, 300)
    m.add(300, position=X * wrong_by, state=ACTIVE)
    for k in range(10):
        T = camera(k)
        if not turning:
            T[:3, :3] = np.eye(3)
        own = np.flatnonzero(in_view(lenses, T, X))
        b = seen(lenses, T, X[own], noise, rng)
        T[:3, 3] *= wrong_by
        m.keyframes.append(Keyframe(k, k, T, own, b))
    return m


def true_spread() -> float:
    centres = np.stack([invert_pose(camera(k))[:3, 3] for k in range(10)])
    return float(np.linalg.norm(centres - centres[0]))


@pytest.mark.parametrize("wrong_by", [0.6, 1.0, 1.8])
def test_the_distance_of_the_lenses_sets_the_scale(lenses: Lenses, wrong_by: float) -> None:
    m = made_up_map(lenses, 5, wrong_by)
    growth = adjust_scale(m, SparseConfig(), FOCAL, 40)
    assert growth == pytest.approx(1 / wrong_by, rel=0.05)
    assert spread(m) == pytest.approx(true_spread(), rel=0.02)


def test_the_scale_is_as_uncertain_as_it_says(lenses: Lenses) -> None:
    errors, sigmas = [], []
    for seed in range(16):
        m = made_up_map(lenses, seed, 1.0, noise=0.4)
        adjust_scale(m, SparseConfig(), FOCAL, 30)
        errors.append(np.log(spread(m) / true_spread()))
        sigmas.append(independent_sigma(m, SparseConfig(), FOCAL))
    assert np.std(sigmas) < 0.3 * np.mean(sigmas)
    # 16 errors: their deviation is within a factor of two of the stated one with a probability over 99.9%
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) / np.mean(sigmas) < 2.0
    assert scale_sigma(m, SparseConfig(), FOCAL) > 2 * sigmas[-1]  # ten measurements of a point share their template


def test_without_turning_the_scale_is_not_known(lenses: Lenses) -> None:
    """Each lens then sees the same translation, whatever its distance to the other; only passing points tell."""
    still = independent_sigma(made_up_map(lenses, 0, 1.0, turning=False), SparseConfig(), FOCAL)
    turned = independent_sigma(made_up_map(lenses, 0, 1.0), SparseConfig(), FOCAL)
    assert still > 2 * turned
    assert scale_sigma(made_up_map(Lenses(), 0, 1.0), SparseConfig(), FOCAL) == np.inf


def test_when_the_scale_is_looked_into() -> None:
    assert [k for k in range(60) if is_due(k)] == [6, 9, 14, 21, 32, 48]


def test_a_walk_seen_through_two_lenses_is_right_and_in_metres() -> None:
    from panobench.methods.sparse.method import SparseMethod
    from panobench.metrics.alignment import match
    from panobench.metrics.trajectory import align
    from panobench.testing import TinySequence, erp_camera, run_method

    camera = erp_camera(384)
    sequence = TinySequence(camera, n=20, rig=two_lenses(202))
    run = run_method(SparseMethod(), sequence, rigs=True)
    matched = match(run.estimate.trajectory, sequence.groundtruth)
    assert matched is not None
    assert len(matched) == 20
    free, rigid = align(matched, "sim3"), align(matched, "se3")
    assert free is not None
    assert rigid is not None
    assert np.sqrt((free.errors()[0] ** 2).mean()) < 0.4e-3
    assert run.estimate.metric
    error = abs(np.log(free.transform.scale))
    assert error < 0.05
    assert error < 3 * run.estimate.extra["scale_sigma_percent"] / 100

"""SO(3), SE(3), Sim(3) and the sphere: identities that hold for every input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from panobench import geometry as g

numbers = st.floats(-3.0, 3.0, allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
small = st.floats(-1e-9, 1e-9)


def hat4(xi: np.ndarray) -> np.ndarray:
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = g.hat(xi[3:]), xi[:3]
    return out


@given(vectors)
@settings(max_examples=50, deadline=None)
def test_so3_exp_is_the_matrix_exponential(w: np.ndarray) -> None:
    assert g.so3_exp(w) == pytest.approx(expm(g.hat(w)), abs=1e-12)


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_se3_exp_is_the_matrix_exponential(rho: np.ndarray, w: np.ndarray) -> None:
    xi = np.concatenate([rho, w])
    assert g.se3_exp(xi) == pytest.approx(expm(hat4(xi)), abs=1e-11)


@given(vectors, vectors)
@settings(max_examples=100, deadline=None)
def test_logarithms_invert_below_half_a_turn(rho: np.ndarray, w: np.ndarray) -> None:
    angle = np.linalg.norm(w)
    if angle > 3.1:
        w = w * 3.1 / angle
    assert g.so3_log(g.so3_exp(w)) == pytest.approx(w, abs=1e-9)
    xi = np.concatenate([rho, w])
    assert g.se3_log(g.se3_exp(xi)) == pytest.approx(xi, abs=1e-7)


@given(small, small, small)
@settings(max_examples=30, deadline=None)
def test_tiny_rotations_keep_their_precision(a: float, b: float, c: float) -> None:
    w = np.array([a, b, c])
    assert g.so3_log(g.so3_exp(w)) == pytest.approx(w, abs=1e-18)


@pytest.mark.parametrize("axis", np.eye(3))
def test_log_of_half_a_turn(axis: np.ndarray) -> None:
    w = g.so3_log(g.so3_exp(np.pi * axis))
    assert np.linalg.norm(w) == pytest.approx(np.pi)
    assert np.abs(w) == pytest.approx(np.pi * axis, abs=1e-7)


def test_everything_broadcasts() -> None:
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(2, 5, 6))
    T = g.se3_exp(xi)
    assert T.shape == (2, 5, 4, 4)
    assert T[1, 3] == pytest.approx(g.se3_exp(xi[1, 3]))
    assert g.invert_pose(T) @ T == pytest.approx(np.broadcast_to(np.eye(4), T.shape), abs=1e-12)
    assert g.se3_log(T).shape == (2, 5, 6)
    assert g.quaternion_from_matrix(T[..., :3, :3]).shape == (2, 5, 4)


def test_quaternions_match_scipy_and_round_trip() -> None:
    q = np.random.default_rng(1).normal(size=(50, 4))
    xyzw = q[:, [1, 2, 3, 0]]
    assert g.matrix_from_quaternion(q) == pytest.approx(Rotation.from_quat(xyzw).as_matrix(), abs=1e-12)
    back = g.quaternion_from_matrix(g.matrix_from_quaternion(q))
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    assert back == pytest.approx(np.where(unit[:, :1] < 0, -unit, unit), abs=1e-12)


def test_the_names_of_contract_1_0_still_mean_xyzw() -> None:
    q = np.random.default_rng(2).normal(size=(5, 4))
    with pytest.warns(DeprecationWarning, match="matrix_from_quaternion"):
        R = g.matrix_from_quat(q)
    assert pytest.approx(Rotation.from_quat(q).as_matrix(), abs=1e-12) == R
    with pytest.warns(DeprecationWarning, match="quaternion_from_matrix"):
        back = g.quat_from_matrix(R)
    assert np.abs(np.sum(back * q, axis=1)) == pytest.approx(np.linalg.norm(q, axis=1))


def test_renormalise_stops_drift() -> None:
    """Composing relative rotations by R_k R_{k-1}^T amplifies rounding; renormalised, they stay rigid."""
    step = g.se3_exp([0.01, 0.0, 0.02, 0.01, 0.02, 0.03])
    previous, current = np.eye(4), step
    for _ in range(500):
        previous, current = current, g.renormalise(current @ g.invert_pose(previous) @ current)
    assert current[:3, :3].T @ current[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
    mirrored = np.diag([1.0, 1.0, -0.9, 1.0])
    assert np.linalg.det(g.renormalise(mirrored)[:3, :3]) == pytest.approx(1.0)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_umeyama_recovers_a_similarity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = g.Sim3(float(rng.uniform(0.1, 10)), g.so3_exp(rng.normal(size=3)), rng.normal(size=3))
    points = rng.normal(size=(6, 3))
    found = g.umeyama(points, true.apply_points(points))
    assert found.scale == pytest.approx(true.scale)
    assert pytest.approx(true.R, abs=1e-8) == found.R
    assert found.t == pytest.approx(true.t, abs=1e-8)
    assert found.inverse().apply_points(true.apply_points(points)) == pytest.approx(points, abs=1e-8)


def test_umeyama_never_mirrors() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    found = g.umeyama(points, points * [1, 1, -1])
    assert np.linalg.det(found.R) == pytest.approx(1.0)


def test_sim3_keeps_poses_rigid() -> None:
    sim3 = g.Sim3(2.0, g.so3_exp([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    T = g.se3_exp(np.random.default_rng(0).normal(size=(4, 6)))
    moved = sim3.apply_poses(T)
    assert moved[:, :3, :3] @ np.swapaxes(moved[:, :3, :3], 1, 2) == pytest.approx(
        np.broadcast_to(np.eye(3), (4, 3, 3)), abs=1e-12
    )
    assert moved[:, :3, 3] == pytest.approx(sim3.apply_points(T[:, :3, 3]))


def test_longitude_and_latitude_follow_the_convention() -> None:
    assert g.directions_from_lonlat(0.0, 0.0) == pytest.approx([0, 0, 1])
    assert g.directions_from_lonlat(np.pi / 2, 0.0) == pytest.approx([1, 0, 0], abs=1e-15)
    assert g.directions_from_lonlat(0.0, np.pi / 2) == pytest.approx([0, -1, 0], abs=1e-15)
    lon, lat = np.random.default_rng(0).uniform(-1, 1, size=(2, 100)) * [[np.pi], [np.pi / 2]]
    back = g.lonlat_from_directions(3.0 * g.directions_from_lonlat(lon, lat))
    assert back[0] == pytest.approx(lon)
    assert back[1] == pytest.approx(lat)


def test_distances_along_a_line_add_up() -> None:
    assert g.distances_along([[0, 0, 0], [3, 4, 0], [3, 4, 0], [3, 4, 2]]).tolist() == [0, 5, 5, 7]
    assert g.distances_along(np.empty((0, 3))).tolist() == [0]


def test_fibonacci_directions_are_even() -> None:
    d = g.fibonacci_sphere(2000)
    assert np.linalg.norm(d, axis=1) == pytest.approx(1.0)
    assert np.abs(d.mean(axis=0)).max() < 1e-3
    nearest = np.sort(d @ d.T, axis=1)[:, -2]
    spacing = np.arccos(nearest) / np.sqrt(4 * np.pi / 2000)
    assert spacing.min() > 0.7
    assert spacing.max() < 1.2

"""Solvers on bearing vectors: essential matrix, P3P, pose and bundle adjustment."""

import numpy as np
import pytest

from panobench.geometry import hat, se3_exp, so3_exp, so3_log
from panobench.inertial.rotation_prior import RotationPrior
from panobench.methods.sparse.absolute import p3p, pose_ransac
from panobench.methods.sparse.bundle import bundle_adjust
from panobench.methods.sparse.descriptors import describe, match
from panobench.methods.sparse.mapping import ray_distance
from panobench.methods.sparse.pose import pose_errors, solve_pose
from panobench.methods.sparse.posegraph import Similarities, optimise_pose_graph
from panobench.methods.sparse.twoview import decompose, epipolar_angle, essential_ransac, five_point, triangulate


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def motion():
    return so3_exp([0.1, 0.4, -0.2]), np.array([0.4, -0.1, 0.25])


def test_five_point_finds_the_true_essential_matrix(rng, motion):
    R, t = motion
    X = rng.normal(size=(5, 3)) * 2  # all around the camera
    E_true = hat(t) @ R
    E_true /= np.linalg.norm(E_true)
    found = five_point(unit(X), unit(X @ R.T + t))
    assert min(min(np.abs(E - E_true).max(), np.abs(E + E_true).max()) for E in found) < 1e-9
    for E in found:
        s = np.linalg.svd(E)[1]
        assert s[0] == pytest.approx(s[1], abs=1e-6)
        assert s[2] == pytest.approx(0, abs=1e-6)


def test_five_point_works_on_a_plane(rng, motion):
    R, t = motion
    X = np.column_stack([rng.uniform(-2, 2, (5, 2)), np.full(5, 3.0)])
    E_true = hat(t) @ R
    E_true /= np.linalg.norm(E_true)
    found = five_point(unit(X), unit(X @ R.T + t))
    assert min(min(np.abs(E - E_true).max(), np.abs(E + E_true).max()) for E in found) < 1e-7


def test_decompose_contains_the_motion(motion):
    R, t = motion
    options = decompose(hat(t) @ R)
    assert len(options) == 4
    assert min(np.abs(r - R).max() + np.abs(d - unit(t)).max() for r, d in options) < 1e-12


def test_essential_ransac_survives_outliers_and_noise(rng, motion):
    R, t = motion
    X = rng.normal(size=(300, 3)) * 2.5
    b1, b2 = unit(X), unit(unit(X @ R.T + t) + 5e-4 * rng.normal(size=X.shape))
    b2[:100] = unit(rng.normal(size=(100, 3)))
    two = essential_ransac(b1, b2, 2e-3, rng)
    assert two is not None
    assert np.degrees(np.arccos(np.clip((np.trace(two.R @ R.T) - 1) / 2, -1, 1))) < 0.3
    assert np.degrees(np.arccos(two.t @ unit(t))) < 2
    assert two.inliers[100:].mean() > 0.9
    assert two.inliers[:100].mean() < 0.1


def test_essential_ransac_refuses_noise(rng):
    assert essential_ransac(unit(rng.normal(size=(60, 3))), unit(rng.normal(size=(60, 3))), 2e-3, rng, 50) is None


def test_epipolar_angle_is_zero_for_true_pairs(rng, motion):
    R, t = motion
    X = rng.normal(size=(50, 3)) * 3
    assert epipolar_angle(hat(t) @ R, unit(X), unit(X @ R.T + t)).max() < 1e-12


def test_triangulation_recovers_points_all_around(rng, motion):
    R, t = motion
    X = rng.normal(size=(50, 3)) * 3
    points, s1, s2 = triangulate(unit(X), unit(X @ R.T + t), R, t)
    np.testing.assert_allclose(points, X, atol=1e-9)
    np.testing.assert_allclose(s1, np.linalg.norm(X, axis=1), atol=1e-9)
    assert (s2 > 0).all()
    distance, angle = ray_distance(unit(X), unit(X @ R.T + t), np.tile(R, (50, 1, 1)), np.tile(t, (50, 1)))
    np.testing.assert_allclose(distance, np.linalg.norm(X, axis=1), rtol=1e-9)
    assert (angle > 0).all()


def test_ray_distance_of_parallel_rays_is_zero():
    b = unit(np.array([[0.1, 0.2, 1.0]]))
    distance, angle = ray_distance(b, b, np.eye(3)[None], np.array([[0.1, 0.0, 0.0]]))
    assert distance[0] == 0
    assert angle[0] == pytest.approx(0, abs=1e-9)


def test_p3p_contains_the_true_pose(rng):
    for _ in range(50):
        T = se3_exp(rng.normal(size=6))
        X = rng.normal(size=(3, 3)) * 2
        b = unit(X @ T[:3, :3].T + T[:3, 3])
        assert min(np.abs(q - T).max() for q in p3p(X, b)) < 1e-5


def test_pose_ransac_survives_half_outliers(rng):
    T = se3_exp(rng.normal(size=6))
    X = rng.normal(size=(120, 3)) * 3
    b = unit(X @ T[:3, :3].T + T[:3, 3])
    b[:60] = unit(rng.normal(size=(60, 3)))
    found = pose_ransac(X, b, 160.0, rng)
    assert found is not None
    np.testing.assert_allclose(found[0], T, atol=1e-6)
    assert found[1][60:].all()


def test_pose_ransac_says_none_for_noise(rng):
    assert pose_ransac(rng.normal(size=(40, 3)), unit(rng.normal(size=(40, 3))), 160.0, rng, 1.0, 60) is None


def test_solve_pose_converges_from_far(rng):
    T = se3_exp([0.3, -0.2, 0.1, 0.2, -0.3, 0.1])
    X = rng.normal(size=(80, 3)) * 3
    b = unit(X @ T[:3, :3].T + T[:3, 3])
    found = solve_pose(np.eye(4), X, b, 160.0, 1.0, 30)
    np.testing.assert_allclose(found, T, atol=1e-7)
    assert pose_errors(found, X, b, 160.0).max() < 1e-4


def test_a_gyroscope_holds_the_rotation_of_a_narrow_view_but_not_against_many_points(rng):
    T_cw = se3_exp([0.4, -0.02, 0.1, 0.02, -0.03, 0.01])

    def wall(count, half):
        return np.column_stack([rng.uniform(-half, half, (count, 2)), rng.uniform(2.5, 3.5, count)])

    def turned(points, seen, prior=None):
        b = unit(seen @ T_cw[:3, :3].T + T_cw[:3, 3])
        T = solve_pose(T_cw, points, b, 107.0, 0.2, 15, None, prior)
        return np.degrees(np.linalg.norm(so3_log(T[:3, :3] @ T_cw[:3, :3].T)))

    def gyroscope(degrees):
        return RotationPrior(so3_exp([0.0, np.radians(degrees), 0.0]) @ T_cw[:3, :3], np.radians(0.03))

    X = wall(60, 1.5)
    known_badly = X * (1 + 0.1 * X[:, :1])  # along the rays of an earlier view
    assert turned(known_badly, X) > 1.0
    assert turned(known_badly, X, gyroscope(0.02)) < 0.1
    X = wall(200, 2.5)
    assert turned(X, X, gyroscope(4.0)) < 0.3


def _bundle(rng, cameras=6, points=80):
    T = np.stack([se3_exp(rng.normal(size=6) * 0.25) for _ in range(cameras)])
    X = rng.normal(size=(points, 3)) * 3
    kf, pt = np.repeat(np.arange(cameras), points), np.tile(np.arange(points), cameras)
    seen = rng.uniform(size=len(kf)) < 0.8  # not every camera sees every point
    kf, pt = kf[seen], pt[seen]
    b = unit(np.einsum("nij,nj->ni", T[kf, :3, :3], X[pt]) + T[kf, :3, 3])
    return T, X, kf, pt, b


def test_bundle_adjustment_recovers_poses_and_points(rng):
    T, X, kf, pt, b = _bundle(rng)
    fixed = np.zeros(len(T), bool)
    fixed[:2] = True
    start = T.copy()
    start[2:] = np.stack([se3_exp(rng.normal(size=6) * 0.03) @ A for A in T[2:]])
    shuffled = rng.permutation(len(kf))
    result = bundle_adjust(
        start,
        X + 0.05 * rng.normal(size=X.shape),
        kf[shuffled],
        pt[shuffled],
        b[shuffled],
        fixed,
        160.0,
        1.0,
        25,
    )
    np.testing.assert_allclose(result.T_cw, T, atol=1e-6)
    np.testing.assert_allclose(result.points, X, atol=1e-5)
    np.testing.assert_allclose(result.T_cw[:2], T[:2], atol=1e-14)


def test_bundle_adjustment_is_the_least_squares_minimum(rng):
    """Against scipy on the same residuals, with noise so that the minimum is not zero."""
    from scipy.optimize import least_squares

    T, X, kf, pt, b = _bundle(rng, 4, 15)
    b = unit(b + 1e-3 * rng.normal(size=b.shape))
    fixed = np.array([True, True, False, False])
    result = bundle_adjust(T, X, kf, pt, b, fixed, 160.0, 1e6, 50)

    def residual(p):
        poses = T.copy()
        poses[2:] = se3_exp(p[:12].reshape(2, 6)) @ T[2:]
        Y = np.einsum("nij,nj->ni", poses[kf, :3, :3], p[12:].reshape(-1, 3)[pt]) + poses[kf, :3, 3]
        m = unit(Y)
        return (160.0 * (m - b * np.sum(m * b, axis=1, keepdims=True))).ravel()

    reference = least_squares(residual, np.concatenate([np.zeros(12), X.ravel()]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert result.cost == pytest.approx(2 * reference.cost, rel=1e-5)


def test_bundle_adjustment_marks_the_outlier(rng):
    T, X, kf, pt, b = _bundle(rng)
    b[11] = unit(rng.normal(size=3))
    fixed = np.zeros(len(T), bool)
    fixed[:2] = True
    result = bundle_adjust(T, X, kf, pt, b, fixed, 160.0, 1.0, 20)
    assert np.argmax(result.errors) == 11
    assert np.median(np.delete(result.errors, 11)) < 0.1


def test_pose_graph_spreads_the_loop_error():
    """A circle walked with a little scale and yaw drift closes again, and an exact graph stays put."""
    n = 24
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    R = so3_exp(np.stack([0 * angle, angle, 0 * angle], axis=1))
    t = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1) * 2
    truth = Similarities(np.ones(n), R, t)
    i, j = np.arange(n - 1), np.arange(1, n)
    steps = truth.between(i, j)
    still = optimise_pose_graph(truth, i, j, steps, np.ones(n - 1))
    np.testing.assert_allclose(still.t, t, atol=1e-9)

    drifted = Similarities(np.full(n - 1, 1.02), steps.R @ so3_exp([0, 0.01, 0]), steps.t)
    walked = truth.copy()
    for a, b in zip(i, j):
        walked.R[b] = walked.R[a] @ drifted.R[a]
        walked.t[b] = walked.scale[a] * walked.R[a] @ drifted.t[a] + walked.t[a]
        walked.scale[b] = walked.scale[a] * drifted.scale[a]
    closing = truth.between(np.array([0]), np.array([n - 1]))
    closed = optimise_pose_graph(
        walked,
        np.append(i, 0),
        np.append(j, n - 1),
        Similarities(
            np.append(drifted.scale, closing.scale),
            np.concatenate([drifted.R, closing.R]),
            np.concatenate([drifted.t, closing.t]),
        ),
        np.append(np.ones(n - 1), 1e4),
    )
    before = np.linalg.norm(walked.t - t, axis=1).max()
    assert np.linalg.norm(closed.t[-1] - t[-1]) < 0.01
    assert closed.scale[-1] == pytest.approx(1, abs=0.01)
    assert np.linalg.norm(closed.t - t, axis=1).max() < 0.4 * before
    np.testing.assert_array_equal(closed.t[0], walked.t[0])


def test_matches_are_mutual_nearest_neighbours_as_opencv_finds_them(rng):
    import cv2

    a = rng.integers(0, 256, (70, 32), dtype=np.uint8)
    b = np.concatenate([rng.integers(0, 256, (300, 32), dtype=np.uint8), a[20:], a[30:40]])
    b[300:, :4] ^= rng.integers(0, 256, (len(b) - 300, 4), dtype=np.uint8)  # close, some of them equally close
    b[350] = b[345]
    distance, index = cv2.batchDistance(a, b, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)[:2]
    back = cv2.batchDistance(b, a, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=1)[1][:, 0]
    for ratio in (0.85, 1.01):
        good = (distance[:, 0] <= 64) & (distance[:, 0] < ratio * distance[:, 1])
        good &= back[index[:, 0]] == np.arange(len(a))
        left, right = match(a, b, ratio=ratio)
        assert len(left) > 30
        assert np.array_equal(left, np.flatnonzero(good))
        assert np.array_equal(right, index[good, 0])
    assert len(match(a, b[:1])[0]) == 0


def test_descriptors_survive_rotation_in_the_image(rng):
    import cv2

    images = [cv2.GaussianBlur(rng.uniform(0, 255, (48, 48)).astype(np.float32), (0, 0), 2.5) for _ in range(60)]
    turn = cv2.getRotationMatrix2D((23.5, 23.5), 40.0, 1.0)

    def templates(pictures):
        crops = [p[16:32, 16:32] for p in pictures]
        wide = [cv2.resize(p[8:40, 8:40], (16, 16), interpolation=cv2.INTER_AREA) for p in pictures]
        return np.stack([crops, crops, wide], axis=1).astype(np.float32)

    a = describe(templates(images))
    b = describe(templates([cv2.warpAffine(p, turn, (48, 48)) for p in images]))
    assert a.shape == (60, 32)
    left, right = match(a, b)
    assert len(left) > 40
    assert (left == right).mean() > 0.95

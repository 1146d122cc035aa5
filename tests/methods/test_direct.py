"""``direct``: its kernels against finite differences, its bundle adjustment, and whole runs on a ray-cast box."""

import cv2
import numpy as np
import pytest
from sparse_scenes import HALF, view, walk

from panobench.cameras.cubemap import CubemapCamera
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.depth.base import DepthEstimator
from panobench.geometry import invert_pose, se3_exp, so3_log, umeyama
from panobench.methods.base import MethodContext
from panobench.methods.direct.config import DirectConfig
from panobench.methods.direct.kernels import FRAME, PATTERN, SIZE, _pattern_residual
from panobench.methods.direct.method import DirectMethod
from panobench.methods.direct.points import choose_pixels, make_points
from panobench.methods.direct.tracking import align
from panobench.methods.direct.window import DirectKeyframe, PointCloud, Window, _host_factor
from panobench.methods.registration import METHODS
from panobench.methods.sparse.faces import build_faces
from panobench.types import DepthEstimate, Frame

N = 16
LEVELS = 3
#: Half a pixel each way: a bilinear image has one slope per pixel, a central difference spans two.
STEPS = (0.012,) * 3 + (0.006,) * 3 + (0.01, 0.01, 0.04)


def box_distance(origin, rays):
    """Distance (..., ) along world rays to the box's walls."""
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0, HALF - origin, -HALF - origin) / rays
    return np.nanmin(np.where(np.isfinite(reach), reach, np.inf), axis=-1)


class BoxDepth(DepthEstimator):
    """The true depth of the first frame, wrong by a factor per pixel if asked."""

    def __init__(self, T_wc, error=0.0):
        super().__init__()
        self.T_wc, self.error = T_wc, error

    def start(self, camera, seed=0):
        self.camera, self.rng = camera, np.random.default_rng(seed)

    def add(self, frame):
        rays = self.camera.rays() @ self.T_wc[:3, :3].T
        depth = box_distance(self.T_wc[:3, 3], rays)
        depth = depth * np.exp(self.error * self.rng.normal(size=depth.shape))
        return DepthEstimate(depth.astype(np.float32), frame.index)


@pytest.fixture(scope="module")
def world():
    camera, truth = ErpCamera(512, 256), walk(N)
    return camera, truth, [view(camera, T) for T in truth]


@pytest.fixture(scope="module")
def window(world):
    """Four keyframes at their true poses and points of the first at their true distance."""
    camera, truth, images = world
    face_set = build_faces(camera, 10**6, LEVELS)
    config = DirectConfig(held=2)
    w = Window(config, face_set, LEVELS)
    for n, i in enumerate((0, 3, 6, 9)):
        w.keyframes.append(DirectKeyframe(n, i, invert_pose(truth[i]), face_set.pyramid(images[i], LEVELS)))
    bearings = choose_pixels(face_set, w.keyframes[0].pyramid[0], 700, np.empty((0, 3)))
    distance = box_distance(truth[0][:3, 3], bearings @ truth[0][:3, :3].T)
    rho = 1 / distance
    w.points = make_points(face_set, w.keyframes[0].pyramid, bearings, 0, rho, 0.5 * rho, 2 * rho)
    w.candidates = PointCloud.empty(LEVELS)
    return w


@pytest.fixture(scope="module")
def soft(window):
    """The second keyframe's faces, so smooth that central differences are the derivative."""
    return np.stack([cv2.GaussianBlur(f.astype(np.float32), (0, 0), 4.0) for f in window.keyframes[1].pyramid[0]])


def residual(window, soft, T, n, rho, affine=(0.0, 0.0)):
    face_set, p = window.face_set, window.points
    res, J, Jr, weight = np.empty(SIZE), np.empty((SIZE, FRAME)), np.empty(SIZE), np.empty(SIZE)
    rel = T @ invert_pose(window.keyframes[0].T_cw)
    energy = _pattern_residual(
        soft, face_set.valid, 1.0, face_set.R_fc, face_set.intrinsics, rel[:3, :3].copy(),
        rel[:3, 3].copy(), p.bearing[n], rho, p.colour[n, 0].copy(), affine[0], affine[1], 1 / face_set.focal, PATTERN,
        50.0, 9.0, res, J, Jr, weight,
    )  # fmt: skip
    return energy, res, J, Jr


def test_jacobians_follow_finite_differences(window, soft):
    T = window.keyframes[1].T_cw
    slopes, numbers = [], []
    for n in range(0, len(window.points), 5):
        rho = window.points.rho[n]
        energy, _, J, Jr = residual(window, soft, T, n, rho)
        if energy < 0:
            continue
        analytic = np.column_stack([J, Jr])
        numeric = np.empty_like(analytic)
        for k in range(FRAME + 1):
            h = STEPS[k]
            if k < 6:
                step = np.zeros(6)
                step[k] = h
                up, down = (residual(window, soft, se3_exp(s * step) @ T, n, rho) for s in (1, -1))
            elif k < FRAME:
                up, down = (residual(window, soft, T, n, rho, (s * h * (k == 6), s * h * (k == 7))) for s in (1, -1))
            else:
                up, down = (residual(window, soft, T, n, rho + s * h) for s in (1, -1))
            if up[0] < 0 or down[0] < 0:
                break
            numeric[:, k] = (up[1] - down[1]) / (2 * h)
        else:
            slopes.append(analytic)
            numbers.append(numeric)
    a, b = np.concatenate(slopes), np.concatenate(numbers)
    assert len(a) > 400
    for k in range(FRAME + 1):
        close = np.abs(a[:, k] - b[:, k]) < 0.1 * np.abs(b[:, k]) + 0.02 * np.abs(b[:, k]).mean()
        assert close.mean() > 0.95  # a pattern that changes its face within the step is no match


def test_host_factor_is_minus_the_adjoint():
    rng = np.random.default_rng(3)
    T = se3_exp(rng.normal(size=6))
    xi = 1e-6 * rng.normal(size=6)
    A = _host_factor(T)[:6, :6]
    np.testing.assert_allclose(se3_exp(A @ xi) @ T, T @ invert_pose(se3_exp(xi)), atol=1e-11)


@pytest.mark.parametrize("shift", [0.01, 0.04])
def test_alignment_converges(world, window, shift):
    _, truth, images = world
    rng = np.random.default_rng(1)
    true = invert_pose(truth[4])
    guess = se3_exp(np.concatenate([shift * rng.normal(size=3), shift * rng.normal(size=3)])) @ true
    found = align(window, window.face_set.pyramid(images[4], LEVELS), guess, np.zeros(2))
    assert found is not None
    off = found.T_cw @ invert_pose(true)
    assert np.linalg.norm(off[:3, 3]) < 0.003
    assert np.degrees(np.linalg.norm(so3_log(off[:3, :3]))) < 0.1
    assert found.used > 0.9


def test_alignment_finds_gain_and_offset(world, window):
    _, truth, images = world
    darker = np.round(0.8 * images[4] + 12).astype(np.uint8)
    found = align(window, window.face_set.pyramid(darker, LEVELS), invert_pose(truth[4]), np.zeros(2))
    assert found is not None
    assert found.affine[0] == pytest.approx(-0.2, abs=0.02)
    assert found.affine[1] == pytest.approx(12, abs=2)


def test_bundle_adjustment_repairs_poses_and_distances(window):
    rng = np.random.default_rng(2)
    copy = Window(window.config, window.face_set, LEVELS)
    copy.keyframes = [DirectKeyframe(k.number, k.frame, k.T_cw.copy(), k.pyramid) for k in window.keyframes]
    copy.points = window.points.select(np.arange(len(window.points)))
    true_rho = copy.points.rho.copy()
    for k in copy.keyframes[2:]:
        k.T_cw = se3_exp(np.concatenate([0.01 * rng.normal(size=3), 0.005 * rng.normal(size=3)])) @ k.T_cw
    copy.points.rho = true_rho * np.exp(0.05 * rng.normal(size=len(true_rho)))
    copy.points.low = true_rho  # carried along, to compare after bad points are dropped
    before = np.median(np.abs(copy.points.rho / true_rho - 1))
    copy.adjust(15)
    for k, original in zip(copy.keyframes, window.keyframes):
        off = k.T_cw @ invert_pose(original.T_cw)
        assert np.linalg.norm(off[:3, 3]) < 0.003
        assert np.degrees(np.linalg.norm(so3_log(off[:3, :3]))) < 0.1
    assert np.median(np.abs(copy.points.rho / copy.points.low - 1)) < 0.3 * before
    assert len(copy.points) > 0.8 * len(true_rho)


def run(world, images, config=None, error=0.0, seed=0):
    camera, truth, _ = world
    method = DirectMethod(config)
    method.start(camera, MethodContext(seed=seed, make_depth=lambda: BoxDepth(truth[0], error)))
    live = [method.track(Frame(i, 0.1 * i, image)) for i, image in enumerate(images)]
    return method.finish(), live


@pytest.mark.parametrize("error", [0.0, 0.1])
def test_panorama_is_tracked(world, error):
    _, truth, images = world
    estimate, live = run(world, images, error=error)
    assert len(estimate.trajectory) == N
    assert all(p is not None for p in live)
    found, true = estimate.trajectory.T_wc, truth
    S = umeyama(found[:, :3, 3], true[:, :3, 3])
    ate = np.sqrt(np.mean(np.sum((S.apply_points(found[:, :3, 3]) - true[:, :3, 3]) ** 2, axis=1)))
    assert ate < 0.004
    assert 2 <= len(estimate.keyframes) < N


def test_same_seed_same_answer(world):
    _, _, images = world
    a, _ = run(world, images[:8], seed=4)
    b, _ = run(world, images[:8], seed=4)
    np.testing.assert_array_equal(a.trajectory.T_wc, b.trajectory.T_wc)


def test_keyframes_are_only_mappable_frames(world):
    camera, truth, images = world
    method = DirectMethod()
    method.start(camera, MethodContext(make_depth=lambda: BoxDepth(truth[0])))
    for i, image in enumerate(images):
        method.track(Frame(i, 0.1 * i, image, mappable=i % 2 == 0))
    assert all(k % 2 == 0 for k in method.finish().keyframes)


def test_black_frames_are_lost_and_blank_input_gives_nothing(world):
    camera, _, images = world
    black = np.zeros_like(images[0])
    estimate, live = run(world, [*images[:6], black, *images[7:10]])
    assert live[6] is None
    assert [p is not None for p in live[7:]] == [True] * 3
    assert len(estimate.trajectory) == 9
    for frames in ([black], [black] * 3):
        method = DirectMethod()
        method.start(camera, MethodContext())
        assert [method.track(Frame(i, 0.1 * i, f)) for i, f in enumerate(frames)] == [None] * len(frames)
        assert len(method.finish().trajectory) == 0


def test_one_frame_gives_no_trajectory_without_a_depth(world):
    camera, _, images = world
    method = DirectMethod()
    method.start(camera, MethodContext())
    assert method.track(Frame(0, 0.0, images[0])) is None
    assert len(method.finish().trajectory) == 0


def test_a_camera_the_depth_estimator_does_not_know_is_shown_as_a_panorama():
    camera = KannalaBrandtCamera(160, 160, 70.0, 70.0, 80.0, 80.0)
    truth = walk(N)
    seen = []

    class Watching(BoxDepth):
        def add(self, frame):
            seen.append((self.camera.kind, frame.image.shape[:2]))
            return super().add(frame)

    method = DirectMethod()
    method.start(camera, MethodContext(make_depth=lambda: Watching(truth[0])))
    live = [method.track(Frame(i, 0.1 * i, view(camera, T))) for i, T in enumerate(truth[:8])]
    assert seen[0][0] == "erp"
    assert all(p is not None for p in live)
    relative = invert_pose(truth[0]) @ truth[7]
    assert np.linalg.norm(live[7][:3, 3] - relative[:3, 3]) < 0.02
    depth = method.finish().depth.depth
    assert depth.shape == (160, 160)
    rays = camera.rays() @ truth[0][:3, :3].T
    known = np.isfinite(depth)
    error = depth[known] / box_distance(truth[0][:3, 3], rays)[known] - 1
    assert known.mean() > 0.6
    assert np.median(np.abs(error)) < 0.02


@pytest.mark.parametrize(
    "camera",
    [
        DoubleSphereCamera(240, 240, 60.0, 60.0, 120.0, 120.0, xi=-0.2, alpha=0.6),
        EucmCamera(240, 240, 75.0, 75.0, 120.0, 120.0, alpha=0.6, beta=1.1),
        MeiCamera(240, 240, 110.0, 110.0, 120.0, 120.0, xi=1.0),
        CubemapCamera(6 * 96, 96),
    ],
    ids=lambda camera: camera.kind,
)
def test_every_central_camera_is_tracked(camera):
    assert camera.kind in next(spec for spec in METHODS if spec.name == "direct").cameras
    truth = walk(N)[:10]
    estimate, live = run((camera, truth, None), [view(camera, T) for T in truth])
    assert all(p is not None for p in live)
    found = estimate.trajectory.T_wc[:, :3, 3]
    moved = umeyama(found, truth[:, :3, 3]).apply_points(found)
    assert np.sqrt(np.mean(np.sum((moved - truth[:, :3, 3]) ** 2, axis=1))) < 0.003

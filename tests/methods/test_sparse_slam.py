"""``sparse`` end to end on a ray-cast box, and its defined outcomes on hopeless input."""

import numpy as np
import pytest
from sparse_scenes import view, walk

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import so3_exp, so3_log, umeyama
from panobench.methods.base import MethodContext
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.faces import build_rig
from panobench.methods.sparse.method import SparseMethod
from panobench.types import Frame

N = 24


def run(camera, images, config=None, seed=0, mappable=lambda i: True):
    method = SparseMethod(config)
    method.start(camera, MethodContext(seed=seed))
    live = [method.track(Frame(i, 0.1 * i, image, mappable=mappable(i))) for i, image in enumerate(images)]
    return method.finish(), live


def errors(estimate, truth):
    index = np.round(estimate.trajectory.times * 10).astype(int)
    found, true = estimate.trajectory.T_wc, truth[index]
    S = umeyama(found[:, :3, 3], true[:, :3, 3])
    e = np.linalg.norm(S.apply_points(found[:, :3, 3]) - true[:, :3, 3], axis=1)
    R = S.apply_poses(found)[:, :3, :3]
    angle = np.degrees(np.linalg.norm(so3_log(np.swapaxes(R, 1, 2) @ true[:, :3, :3]), axis=1))
    return float(np.sqrt(np.mean(e**2))), float(angle.max()), index


@pytest.fixture(scope="module")
def panoramas():
    camera, truth = ErpCamera(512, 256), walk(N)
    return camera, truth, [view(camera, T) for T in truth]


def test_panorama_is_tracked_to_millimetres(panoramas):
    camera, truth, images = panoramas
    estimate, live = run(camera, images)
    ate, angle, index = errors(estimate, truth)
    assert list(index) == list(range(N))  # also the frames before the map are filled in
    assert ate < 0.004
    assert angle < 0.2
    assert live[0] is None
    assert live[-1] is not None
    assert 2 <= len(estimate.keyframes) < N
    assert set(estimate.keyframes) <= set(range(N))


def test_same_seed_same_answer(panoramas):
    camera, _, images = panoramas
    a, _ = run(camera, images[:12], seed=3)
    b, _ = run(camera, images[:12], seed=3)
    np.testing.assert_array_equal(a.trajectory.T_wc, b.trajectory.T_wc)


def test_held_out_frames_are_tracked_but_never_keyframes(panoramas):
    camera, truth, images = panoramas
    estimate, _ = run(camera, images, mappable=lambda i: i % 3 != 1)
    ate, _, index = errors(estimate, truth)
    assert len(index) == N
    assert not [k for k in estimate.keyframes if k % 3 == 1]
    assert ate < 0.006


def test_pinhole_uses_the_same_code():
    camera, truth = PinholeCamera.from_fov(480, 100, 75), walk(N)
    estimate, _ = run(camera, [view(camera, T) for T in truth])
    ate, angle, index = errors(estimate, truth)
    assert len(index) == N
    assert ate < 0.015
    assert angle < 0.5


def test_pure_rotation_is_waited_out(panoramas):
    camera, truth, _ = panoramas
    start = truth[0]
    turning = []
    for i in range(6):
        T = start.copy()
        T[:3, :3] = start[:3, :3] @ so3_exp([0, 0.05 * (i - 5), 0])
        turning.append(T)
    poses = np.concatenate([np.array(turning), truth[1:14]])
    estimate, live = run(camera, [view(camera, T) for T in poses])
    assert all(p is None for p in live[:6])
    ate, _, index = errors(estimate, poses)
    assert len(index) == len(poses)
    assert ate < 0.005


@pytest.mark.parametrize("frames", [1, 3])
def test_featureless_frames_give_no_poses(frames):
    camera = ErpCamera(256, 128)
    for grey in (0, 127):
        estimate, live = run(camera, [np.full((128, 256, 3), grey, np.uint8)] * frames)
        assert live == [None] * frames
        assert len(estimate.trajectory) == 0
        assert estimate.trajectory.T_wc.shape == (0, 4, 4)


def test_single_and_repeated_frames_give_no_poses(panoramas):
    camera, _, images = panoramas
    for repeated in (1, 5):
        estimate, live = run(camera, images[:1] * repeated)
        assert live == [None] * repeated
        assert len(estimate.trajectory) == 0


def test_duplicated_frames_keep_the_pose(panoramas):
    camera, truth, images = panoramas
    order = [*range(10), 9, 9, *range(10, 16)]
    estimate, _ = run(camera, [images[i] for i in order])
    ate, _, index = errors(estimate, truth[order])
    assert len(index) == len(order)
    assert ate < 0.005


def test_black_frames_in_between_are_lost_not_invented(panoramas):
    camera, truth, images = panoramas
    black = np.zeros_like(images[0])
    shown = [*images[:12], black, *images[13:]]
    estimate, live = run(camera, shown)
    ate, _, index = errors(estimate, truth)
    assert live[12] is None
    assert 12 not in index
    assert len(index) >= N - 2
    assert ate < 0.006


def test_cube_faces_cover_the_sphere_once():
    rig = build_rig(ErpCamera(512, 256), 10**6, 3)
    assert rig.count == 6
    np.testing.assert_allclose(np.linalg.det(rig.R_fc), 1, atol=1e-12)
    fx = rig.intrinsics[0]
    assert fx == pytest.approx(512 / (2 * np.pi), rel=0.2)
    h, w = rig.size
    u, v = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    angle = 1 / (fx**2 * (1 + ((u - w / 2) / fx) ** 2 + ((v - h / 2) / fx) ** 2) ** 1.5)
    assert (rig.core * angle).sum() == pytest.approx(4 * np.pi, rel=0.05)


def test_face_images_show_what_the_camera_sees():
    """A panorama whose brightness is a function of direction comes out the same on every face."""
    camera = ErpCamera(256, 128)
    image = np.round(127 + 100 * camera.rays() @ np.array([0.3, 0.5, -0.8])).astype(np.uint8)
    rig = build_rig(camera, 10**6, 2)
    faces = rig.pyramid(image, 2)[0]
    h, w = rig.size
    grid = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), axis=-1).reshape(-1, 2)
    for f in range(rig.count):
        expected = 127 + 100 * rig.rays(f, grid) @ np.array([0.3, 0.5, -0.8])
        difference = np.abs(faces[f].ravel() - expected)[rig.core[f].ravel()]
        assert difference.max() < 2.5


def test_config_is_used(panoramas):
    camera, _, images = panoramas
    few, _ = run(camera, images[:10], SparseConfig(features=150))
    many, _ = run(camera, images[:10], SparseConfig(features=600))
    assert few.extra["points"] < many.extra["points"]

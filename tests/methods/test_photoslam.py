"""``photoslam``: poses of ``sparse``, a map that renders, Gaussians that follow corrected keyframes."""

import numpy as np
import pytest
from sparse_scenes import view, walk

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import invert_pose, make_pose, se3_exp, so3_exp, umeyama
from panobench.methods.base import MethodContext
from panobench.methods.photoslam.config import PhotoslamConfig
from panobench.methods.photoslam.mapper import PhotoslamMapper
from panobench.methods.photoslam.method import PhotoslamMethod
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.pointmap import ACTIVE, Keyframe, PointMap
from panobench.types import Frame

QUICK = PhotoslamConfig(
    tracking=SparseConfig(features=400), mapping_iterations=15, final_iterations=60, pixels_per_gaussian=12.0
)
CAMERAS = {"erp": ErpCamera(256, 128), "pinhole": PinholeCamera(192, 160, 100.0, 100.0, 96.0, 80.0)}


def run(camera, n=22, config=QUICK, seed=0):
    truth = walk(n)
    images = [view(camera, T) for T in truth]
    method = PhotoslamMethod(config)
    method.start(camera, MethodContext(seed=seed))
    for i, image in enumerate(images):
        method.track(Frame(i, 0.1 * i, image, mappable=i % 5 != 4))
    return method, method.finish(), truth, images


@pytest.mark.parametrize("kind", CAMERAS)
def test_tracked_and_mapped(kind):
    camera = CAMERAS[kind]
    method, estimate, truth, images = run(camera)
    found = estimate.trajectory
    assert len(found) >= 20
    true = truth[np.round(found.times * 10).astype(int)]
    S = umeyama(found.positions, true[:, :3, 3])
    assert np.sqrt(np.mean(np.sum((S.apply_points(found.positions) - true[:, :3, 3]) ** 2, axis=1))) < 0.02
    assert all(k % 5 != 4 for k in estimate.keyframes)
    assert len(estimate.map) == estimate.extra["gaussians"] > 300
    k = len(found) // 2  # frame 4, 9, ... were never mapped
    held_out = min(range(len(found)), key=lambda j: (round(found.times[j] * 10) % 5 != 4, abs(j - k)))
    image = images[round(found.times[held_out] * 10)] / 255
    shown = method.render(camera, found.T_wc[held_out])
    assert -10 * np.log10(np.mean((shown - image) ** 2)) > 15
    assert np.corrcoef(shown.ravel(), image.ravel())[0, 1] > 0.7


def test_same_seed_same_answer():
    a, b = (run(CAMERAS["erp"], n=14, seed=3)[1] for _ in range(2))
    np.testing.assert_array_equal(a.trajectory.T_wc, b.trajectory.T_wc)
    np.testing.assert_array_equal(a.map.means, b.map.means)


def feature_map(camera, T_wc, seed=0):
    """Two keyframes and points on a sphere of radius two around the first."""
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(300, 3))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    m = PointMap(1)
    positions = 2 * b @ T_wc[:3, :3].T + T_wc[:3, 3]
    ids = m.add(300, state=ACTIVE, position=positions)
    m.keyframes.append(Keyframe(0, 0, invert_pose(T_wc), ids, b))
    return m


def test_depth_comes_from_the_points_around():
    camera = ErpCamera(64, 32)
    T = make_pose(so3_exp([0.1, 0.4, 0.0]), [1.0, 2.0, 3.0])
    points = feature_map(camera, T)
    points.position[:] = T[:3, 3] + 1.5 * (points.position - T[:3, 3])
    mapper = PhotoslamMapper(camera, QUICK, 0)
    mapper.add(points, 0, 0, np.full((32, 64, 3), 90, np.uint8))
    distance = np.linalg.norm(mapper.map.gaussians.means - T[:3, 3], axis=1)
    assert np.median(np.abs(distance / 3.0 - 1)) < 0.05


def test_gaussians_follow_their_keyframe():
    """Moved and scaled as a loop closure does, the map shows the same from the corrected pose."""
    camera = ErpCamera(64, 32)
    T = make_pose(so3_exp([0.1, 0.4, 0.0]), [1.0, 2.0, 3.0])
    points = feature_map(camera, T)
    mapper = PhotoslamMapper(camera, QUICK, 0)
    image = np.random.default_rng(1).integers(0, 255, (32, 64, 3)).astype(np.uint8)
    mapper.add(points, 0, 0, image)
    assert mapper.follow(points) == 0
    renderer = mapper.levels[0].renderer
    before = renderer.forward(mapper.map.gaussians, T)
    new = se3_exp([0.3, 0.1, -0.2, 0.05, 0.1, 0.0]) @ T
    points.position[:] = (1.25 * (points.position - T[:3, 3]) @ T[:3, :3]) @ new[:3, :3].T + new[:3, 3]
    points.keyframes[0].T_cw = invert_pose(new)
    assert mapper.follow(points) == 1
    after = renderer.forward(mapper.map.gaussians, new)
    np.testing.assert_allclose(after.planes, before.planes, atol=0.02)
    np.testing.assert_allclose(after.depth, 1.25 * before.depth, rtol=0.02, atol=0.02)


def test_nothing_from_blank_frames_or_none():
    camera = CAMERAS["erp"]
    black = np.zeros((camera.height, camera.width, 3), np.uint8)
    for count in (0, 4):
        method = PhotoslamMethod()
        method.start(camera, MethodContext())
        assert [method.track(Frame(i, 0.1 * i, black)) for i in range(count)] == [None] * count
        estimate = method.finish()
        assert len(estimate.trajectory) == 0
        assert estimate.map is None
        assert method.render(camera, np.eye(4)) is None

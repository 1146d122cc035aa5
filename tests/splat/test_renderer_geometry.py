"""What the image must look like by geometry alone: pixel centres, seam, poles, rotations, footprint bounds."""

from __future__ import annotations

import numpy as np
import pytest
from splat_scenes import CAMERAS, CASES, POSE, gaussian_map, random_scene, reference

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import make_pose, so3_exp
from panobench.splat.render import Renderer
from panobench.splat.view import Projection

LOW_PASS = 0.3


def yaw(angle: float) -> np.ndarray:
    """The camera turned right by ``angle``: its z axis moves towards its x axis."""
    return make_pose(so3_exp([0, angle, 0]), [0, 0, 0])


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A rotation taking unit vector a to b."""
    axis, cosine = np.cross(a, b), float(a @ b)
    norm = np.linalg.norm(axis)
    if norm < 1e-9:
        other = np.eye(3)[np.argmin(np.abs(a))]
        axis, norm = np.cross(a, other), np.linalg.norm(np.cross(a, other))
    return so3_exp(axis / norm * np.arctan2(np.linalg.norm(np.cross(a, b)), cosine))


@pytest.mark.parametrize("projection", ["sphere", "erp"])
@pytest.mark.parametrize("k", [1, 7, 16, 36, 71])
def test_yaw_by_k_pixels_rolls_the_panorama_by_k(projection: Projection, k: int) -> None:
    g = random_scene(150, 20, "erp", projection)
    T = make_pose(np.eye(3), POSE[:3, 3]) if projection == "erp" else POSE
    renderer = Renderer(ErpCamera(72, 36), projection, stop=0.0)
    want = renderer.forward(g, T)
    got = renderer.forward(g, T @ yaw(2 * np.pi * k / 72))
    for a, b in ((got.colour, want.colour), (got.opacity, want.opacity), (got.depth / 4, want.depth / 4)):
        np.testing.assert_allclose(a, np.roll(b, -k, axis=1), atol=1e-5)
    assert want.opacity.max() > 0.9


def test_roll_holds_with_early_stop_and_odd_tiles() -> None:
    """Tiles that stop early may differ by the light they did not wait for, not more."""
    g = random_scene(600, 21, "erp", logit=3.0)
    g.log_scales += 0.7
    renderer = Renderer(ErpCamera(72, 36), stop=1e-2)
    want = renderer.forward(g, POSE)
    got = renderer.forward(g, POSE @ yaw(2 * np.pi * 5 / 72))
    error = np.abs(got.colour - np.roll(want.colour, -5, axis=1)).max()
    assert 1e-5 < error < 1e-2  # some tile did stop early


ERP_PIXELS = [(18, 36), (10, 50), (25, 0), (12, 71), (0, 30), (35, 3), (0, 0)]
PINHOLE_PIXELS = [(25, 35), (0, 0), (49, 69), (10, 60), (27, 31)]
PLACES = [("erp", ij) for ij in ERP_PIXELS] + [("pinhole", ij) for ij in PINHOLE_PIXELS]


@pytest.mark.parametrize(("camera", "pixel"), PLACES)
def test_tiny_gaussian_on_the_sphere(camera: str, pixel: tuple[int, int]) -> None:
    """A point at a pixel's ray is the low-pass alone: opacity exp(-tan(angle)^2 / (2 low_pass pix^2)) everywhere."""
    cam = CAMERAS[camera]
    rays = cam.rays()
    ray = rays[pixel]
    pix = 2 * np.pi / 72 if camera == "erp" else 1 / 42.0
    low_pass = 4.0
    image = Renderer(cam, low_pass=low_pass).forward(gaussian_map(2 * ray, scale=1e-6, logit=3.0), np.eye(4)).opacity
    cosine = rays @ ray
    tan2 = np.linalg.norm(np.cross(rays, ray), axis=-1) ** 2 / np.where(cosine > 0.1, cosine, 1) ** 2
    want = np.exp(-tan2 / (2 * low_pass * pix**2)) / (1 + np.exp(-3.0))
    want = np.where((want >= 1 / 255) & (cosine > 0.1), want, 0)
    assert np.unravel_index(image.argmax(), image.shape) == pixel
    np.testing.assert_allclose(image, want, atol=2e-5)


@pytest.mark.parametrize(("camera", "projection"), [("erp", "erp"), ("pinhole", "pinhole")])
@pytest.mark.parametrize("offset", [(0, 0), (5, 20), (-6, -31)])
def test_tiny_gaussian_to_first_order(camera: str, projection: Projection, offset: tuple[int, int]) -> None:
    """A point at a pixel's ray is round in pixels: exp(-(dx^2 + dy^2) / (2 low_pass)), wrapped at the seam."""
    cam = CAMERAS[camera]
    i, j = cam.height // 2 + offset[0], cam.width // 2 + offset[1]
    image = Renderer(cam, projection).forward(gaussian_map(2 * cam.rays()[i, j], 1e-6, logit=3.0), np.eye(4)).opacity
    y, x = np.mgrid[: cam.height, : cam.width]
    dx = np.abs(x - j)
    dx = np.minimum(dx, cam.width - dx) if camera == "erp" else dx
    want = np.exp(-(dx**2 + (y - i) ** 2) / (2 * LOW_PASS)) / (1 + np.exp(-3.0))
    np.testing.assert_allclose(image, np.where(want >= 1 / 255, want, 0), atol=2e-5)


@pytest.mark.parametrize("projection", ["sphere", "erp"])
def test_gaussian_on_the_seam_looks_like_one_in_front(projection: Projection) -> None:
    renderer = Renderer(ErpCamera(96, 48), projection)
    shape = {"scale": [0.5, 0.2, 0.1], "logit": 2.0}
    front = renderer.forward(gaussian_map([0, 0.3, 2.0], **shape), np.eye(4)).opacity.copy()
    behind = renderer.forward(gaussian_map([0, 0.3, -2.0], **shape), np.eye(4)).opacity
    assert behind[27, 0] > 0.3
    assert behind[27, -1] > 0.3
    np.testing.assert_allclose(behind, np.roll(front, 48, axis=1), atol=1e-5)


@pytest.mark.parametrize("pole", [-1, 1])
@pytest.mark.parametrize("scale", [0.05, 0.4, 3.0])
def test_gaussian_on_a_pole_is_round(pole: int, scale: float) -> None:
    """Rows are circles about the pole; each has one value, falling away from it, the other side stays empty."""
    renderer = Renderer(ErpCamera(128, 64))
    image = renderer.forward(gaussian_map([0, 2.0 * pole, 0], scale, logit=3.0), np.eye(4)).opacity
    rows = image.mean(axis=1)[:: -pole if pole == 1 else 1]
    np.testing.assert_allclose(
        image[:: -pole if pole == 1 else 1], np.broadcast_to(rows[:, None], (64, 128)), atol=1e-5
    )
    angle = (np.arange(64) + 0.5) * np.pi / 64
    variance = (scale / 2) ** 2 + LOW_PASS * (2 * np.pi / 128) ** 2
    want = np.exp(-(np.tan(angle) ** 2) / (2 * variance)) / (1 + np.exp(-3.0))
    want = np.where((want >= 1 / 255) & (np.cos(angle) > 0.1), want, 0)
    np.testing.assert_allclose(rows, want, atol=2e-5)


def test_sphere_projection_is_equivariant_under_rotation() -> None:
    """A pixel sees the same light after any rotation that leaves its ray where it was: at poles, seam and elsewhere."""
    camera = ErpCamera(72, 36)
    g = random_scene(120, 22, "erp")
    renderer = Renderer(camera, stop=0.0)
    base = renderer.forward(g, POSE)
    rng = np.random.default_rng(0)
    rays = camera.rays()
    targets = [(0, 0), (35, 71), (0, 40), (17, 71)] + [(rng.integers(36), rng.integers(72)) for _ in range(40)]
    seen = 0.0
    for target in targets:
        source = rng.integers(36), rng.integers(72)
        spin = so3_exp(rays[source] * rng.uniform(0, 2 * np.pi))
        turned = renderer.forward(g, POSE @ make_pose(spin @ between(rays[target], rays[source]), [0, 0, 0]))
        np.testing.assert_allclose(turned.colour[target], base.colour[source], atol=2e-5)
        np.testing.assert_allclose(turned.depth[target], base.depth[source], atol=1e-4)
        seen += float(base.opacity[source])
    assert seen > 5


def test_panorama_and_pinhole_agree_on_shared_rays() -> None:
    """The sphere projection does not care which camera a ray belongs to, given the same angular low-pass."""
    g = random_scene(120, 23, "erp")
    erp = ErpCamera(72, 36)
    focal = 72 / (2 * np.pi)
    flat = PinholeCamera(33, 21, focal, focal, 16.5, 10.5)
    image = Renderer(flat, stop=0.0).forward(g, POSE)
    panorama = Renderer(erp, stop=0.0)
    centre = erp.rays()[18, 36]
    for i, j in [(10, 16), (0, 0), (20, 32), (3, 25), (15, 4)]:
        turn = between(centre, flat.rays()[i, j])
        same = panorama.forward(g, POSE @ make_pose(turn, [0, 0, 0]))
        np.testing.assert_allclose(same.colour[18, 36], image.colour[i, j], atol=2e-5)
    assert image.opacity.max() > 0.9


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_bounds_never_cut_a_footprint(camera: str, projection: Projection) -> None:
    """One Gaussian at a time, from points to blobs as wide as the view, anywhere: all its pixels are drawn."""
    cam: Camera = CAMERAS[camera]
    rng = np.random.default_rng(24)
    renderer = Renderer(cam, projection)
    drawn = 0
    for _ in range(60):
        mean = rng.normal(size=3) + ([0, 0, 1] if camera == "pinhole" else 0)
        mean *= rng.uniform(0.3, 4) / np.linalg.norm(mean)
        largest = 1.5
        if projection == "erp":  # footprints over half the panorama are a matter of convention
            mean[1] *= 0.5
            largest = 0.3
        scale = np.exp(rng.uniform(-6, np.log(largest), size=3))
        g = gaussian_map(mean, scale, rng.normal(2, 3), 1.0, rng.normal(size=(1, 4)))
        want = reference(g, cam, np.eye(4), projection)
        got = renderer.forward(g, np.eye(4)).opacity
        error = np.abs(got - want.out.opacity.detach().numpy())
        if projection == "erp" and (want.out.opacity > 0).any(dim=0).sum() > cam.width // 2:
            continue
        assert error[want.steady].max(initial=0) < 2e-5, (mean, scale)
        drawn += int((got > 0).any())
    assert drawn > 20

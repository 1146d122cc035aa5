"""Models against independent implementations, each other where they coincide, and published numbers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from panobench.cameras.calibration import builtin_calibration
from panobench.cameras.cubemap import FACES, CubemapCamera
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError

SIZE = (640, 480)
K = np.array([[300.0, 0, 319.5], [0, 310.0, 239.5], [0, 0, 1]])  # OpenCV: first centre at 0
FOCAL = (300.0, 310.0, 320.0, 240.0)  # the same here: first centre at 0.5


def cone(degrees: float, n: int = 300) -> np.ndarray:
    rng = np.random.default_rng(3)
    theta, phi = np.deg2rad(degrees) * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize(
    "k",
    [
        (),
        (-0.28, 0.07, 8e-4, -1e-4),
        (-0.28, 0.07, 8e-4, -1e-4, 0.02),
        (0.3, 0.05, 1e-3, 2e-3, 0.01, 0.6, 0.1, 0.02),
    ],
)
def test_pinhole_as_opencv(k: tuple[float, ...]) -> None:
    points = cone(35)
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(k) if k else None)[0][:, 0]
    pixels, valid = PinholeCamera(*SIZE, *FOCAL, k).project(points)
    assert valid.mean() > 0.9
    assert np.abs(pixels - expected - 0.5)[valid].max() < 1e-9


def test_fisheye_as_opencv() -> None:
    points, k = cone(85), (0.02, -0.01, 0.004, -0.0008)
    camera = KannalaBrandtCamera(*SIZE, 150.0, 155.0, 320.0, 240.0, k)
    matrix = np.array([[150.0, 0, 319.5], [0, 155.0, 239.5], [0, 0, 1]])
    expected = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(k))[0][:, 0]
    pixels, valid = camera.project(points)
    assert valid.mean() > 0.9
    assert np.abs(pixels - expected - 0.5)[valid].max() < 1e-9


def test_models_that_coincide() -> None:
    points = cone(70)
    alpha = 0.6
    f = np.array(FOCAL[:2])
    unified = EucmCamera(*SIZE, *FOCAL, alpha=alpha, beta=1.0).project(points)
    sphere = DoubleSphereCamera(*SIZE, *FOCAL, xi=0.0, alpha=alpha).project(points)
    # Mei's plane is at distance 1 from a point xi behind the centre: xi = alpha / (1 - alpha), f' = f / (1 - alpha).
    mei = MeiCamera(*SIZE, *(f / (1 - alpha)), *FOCAL[2:], xi=alpha / (1 - alpha)).project(points)
    for pixels, valid in (sphere, mei):
        assert np.array_equal(valid, unified[1])
        assert np.allclose(pixels[valid], unified[0][valid], atol=1e-9)
    plain = PinholeCamera(*SIZE, *FOCAL).project(points)
    for camera in (
        EucmCamera(*SIZE, *FOCAL, alpha=0.0),
        DoubleSphereCamera(*SIZE, *FOCAL, xi=0.0, alpha=0.0),
        MeiCamera(*SIZE, *FOCAL, xi=0.0),
    ):
        pixels, valid = camera.project(points)
        assert np.array_equal(valid, plain[1])
        assert np.allclose(pixels[valid], plain[0][valid], atol=1e-9)


def test_double_sphere_from_its_construction() -> None:
    """Onto a unit sphere, shifted by xi, onto a second sphere, shifted by alpha / (1 - alpha), onto a plane."""
    points, xi, alpha = cone(100) * 2.5, -0.2, 0.59
    p = points / np.linalg.norm(points, axis=1, keepdims=True) + [0, 0, xi]
    p = p / np.linalg.norm(p, axis=1, keepdims=True) + [0, 0, alpha / (1 - alpha)]
    expected = p[:, :2] / p[:, 2:] / (1 - alpha) * 100 + [320, 240]
    pixels, valid = DoubleSphereCamera(*SIZE, 100, 100, 320, 240, xi=xi, alpha=alpha).project(points)
    assert valid.mean() > 0.9
    assert np.abs(pixels - expected)[valid].max() < 1e-9


def test_double_sphere_sees_every_ray_its_pixels_have() -> None:
    """With xi > 0 and a wide image the rays at the limit lie beyond the bound printed in the paper."""
    camera = DoubleSphereCamera(63, 32, 13.9, 59.0, 10.0, 20.6, xi=0.6, alpha=0.648)
    rays = camera.unproject(camera.pixel_grid())
    known = np.isfinite(rays).all(axis=-1)
    assert 0.3 < known.mean() < 0.9
    assert rays[known][:, 2].min() < -0.81
    assert camera.project(rays[known])[1].all()


def test_equidistant_fisheye_measures_angles() -> None:
    camera = KannalaBrandtCamera.equidistant(400, 200)
    edge = camera.unproject([[400.0, 200.0], [200.0, 0.0], [300.0, 200.0]])
    assert np.rad2deg(np.arccos(edge[:, 2])) == pytest.approx([100, 100, 50])
    assert camera.valid_mask().mean() == pytest.approx(np.pi / 4, abs=0.01)
    # Solid angle of the cone: 2 pi (1 - cos 100 deg).
    assert camera.solid_angle().sum() == pytest.approx(2 * np.pi * (1 - np.cos(np.deg2rad(100))), rel=5e-3)


def test_panorama_convention() -> None:
    camera = ErpCamera(360, 180)
    directions = {(0, 0, 1): (180, 90), (1, 0, 0): (270, 90), (-1, 0, 0): (90, 90), (0, -1, 0): (180, 0)}
    for point, pixel in directions.items():
        assert camera.project(point)[0] == pytest.approx(pixel)
    assert camera.project([0.0, 1.0, 0.0])[0][1] == pytest.approx(180)
    # A little to the left of backwards is the first column, a little to the right the last.
    assert camera.project([[-1e-9, 0, -1], [1e-9, 0, -1], [0.0, 0, -1]])[0][:, 0] == pytest.approx(
        [0, 360, 0], abs=1e-6
    )


def test_limited_panorama_is_a_mask_not_a_crop() -> None:
    camera = ErpCamera(360, 180, hfov_deg=120, lat_min_deg=-27, lat_max_deg=51)
    valid = camera.valid_mask()
    assert valid.sum() == 120 * 78
    assert valid[90 - 51 : 90 + 27, 120:240].all()
    assert np.isfinite(camera.rays()).all()
    assert camera.project([0, 0, 1.0])[1]
    assert not camera.project([[0, 0, -1.0], [0, -1, 0.1]])[1].any()
    assert camera.scaled(180).valid_mask().sum() == 60 * 39
    coverage = np.deg2rad(120) * (np.sin(np.deg2rad(51)) + np.sin(np.deg2rad(27)))
    assert camera.solid_angle().sum() == pytest.approx(coverage, rel=1e-9)


def test_panorama_rejects_impossible_shapes() -> None:
    with pytest.raises(CalibrationError, match="twice as wide"):
        ErpCamera(640, 480)
    with pytest.raises(CalibrationError, match="360"):
        ErpCamera(200, 100, hfov_deg=400)
    with pytest.raises(CalibrationError, match="latitudes"):
        ErpCamera(200, 100, lat_min_deg=50, lat_max_deg=20)


def test_perspective_from_field_of_view() -> None:
    camera = PinholeCamera.from_fov(600, 120, 60)
    assert (camera.width, camera.height) == (600, 200)
    assert camera.fov_deg == pytest.approx((120, 60))
    rays = camera.unproject([[0, 100], [600, 100], [300, 0], [300, 200]])
    assert np.rad2deg(np.arccos(rays[:, 2])) == pytest.approx([60, 60, 30, 30])
    with pytest.raises(CalibrationError, match="180"):
        PinholeCamera.from_fov(600, 180, 60)


def test_palvio_horizon() -> None:
    """Published numbers: the horizon (90 degrees off the axis) lies 376.9 px from the centre."""
    camera = builtin_calibration("palvio_up")
    assert isinstance(camera, ScaramuzzaCamera)
    assert np.rad2deg(camera.polar_angle(376.9)) == pytest.approx(90, abs=0.02)
    assert camera.inv_poly[0] == pytest.approx(376.9, abs=0.1)
    pixels, valid = camera.project([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0]])
    assert valid.all()
    assert np.hypot(*(pixels - [camera.cx, camera.cy]).T) == pytest.approx([376.85] * 3, abs=0.05)
    # Between 40 and 120 degrees, says the lens; 38 to 117 within the mask.
    assert np.rad2deg(camera.polar_angle([160.0, 500.0])) == pytest.approx([38.1, 116.8], abs=0.1)


@pytest.mark.parametrize("name", ["palvio_up", "palvio_down"])
def test_palvio_inverse_polynomial_gives_the_same_radius(name: str) -> None:
    camera = builtin_calibration(name)
    assert isinstance(camera, ScaramuzzaCamera)
    theta = np.deg2rad(np.linspace(40, 118, 50))
    by_inverse = np.polynomial.polynomial.polyval(theta - np.pi / 2, camera.inv_poly)
    rho, valid = camera.radius(np.sin(theta), np.cos(theta))
    assert valid.all()
    assert np.abs(rho - by_inverse).max() < 0.06


def test_cubemap_faces_look_where_their_names_say() -> None:
    camera = CubemapCamera(60, 10)
    centres = camera.unproject([[10 * k + 5, 5] for k in range(6)])
    expected = {
        "front": (0, 0, 1),
        "right": (1, 0, 0),
        "back": (0, 0, -1),
        "left": (-1, 0, 0),
        "up": (0, -1, 0),
        "down": (0, 1, 0),
    }
    assert centres == pytest.approx(np.array([expected[name] for name in FACES], dtype=float))
    with pytest.raises(CalibrationError, match="six"):
        CubemapCamera(60, 20)


def test_annular_lens_needs_sensible_polynomials() -> None:
    with pytest.raises(CalibrationError, match="negative"):
        ScaramuzzaCamera(64, 64, (20.0,), 32, 32)
    with pytest.raises(CalibrationError, match="singular"):
        ScaramuzzaCamera(64, 64, (-20.0,), 32, 32, c=1.0, d=1.0, e=1.0)
    with pytest.raises(CalibrationError, match="stops growing at r = "):
        ScaramuzzaCamera(640, 640, (-20.0, 0.0, -0.1), 320, 320, r_min=200)

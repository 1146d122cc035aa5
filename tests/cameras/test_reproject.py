"""Reprojection against the true images of functions on the sphere."""

from __future__ import annotations

import numpy as np
import pytest
from sphere_images import picture, smooth, zone_plate

from panobench.cameras.base import Camera
from panobench.cameras.calibration import builtin_calibration
from panobench.cameras.cubemap import CubemapCamera
from panobench.cameras.double_sphere import DoubleSphereCamera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.eucm import EucmCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.views import VIEW_DIRECTIONS, look_rotation, upright_rotation, view_rotation
from panobench.errors import CalibrationError, UnsupportedError
from panobench.geometry import invert_pose, make_pose, so3_exp

ERP = ErpCamera(512, 256)
CAMERAS: dict[str, Camera] = {
    "erp": ERP,
    "pinhole": PinholeCamera(300, 200, 150, 150, 150, 100, (-0.2, 0.03, 1e-3, 1e-3)),
    "pal": builtin_calibration("palvio_up").scaled(320),
    "fisheye": KannalaBrandtCamera.equidistant(300, 200),
    "ds": DoubleSphereCamera(300, 200, 100, 100, 150, 100, xi=-0.2, alpha=0.59),
    "eucm": EucmCamera(300, 200, 100, 100, 150, 100, alpha=0.6, beta=1.1),
    "omni": MeiCamera(300, 200, 150, 150, 150, 100, xi=1.1),
    "cubemap": CubemapCamera(600, 100),
}
ODD = look_rotation(33.0, 21.0, 12.0)


@pytest.mark.parametrize("source", sorted(CAMERAS))
@pytest.mark.parametrize("target", sorted(CAMERAS))
def test_any_camera_to_any_camera(source: str, target: str) -> None:
    a, b = CAMERAS[source], CAMERAS[target]
    reprojector = Reprojector(a, b, ODD)
    expected = picture(b, ODD)
    difference = np.abs(reprojector.image(picture(a)) - expected)[reprojector.valid]
    assert reprojector.valid.sum() > 1000
    # Bilinear interpolation of a signal of frequency 5 on pixels of 1/60 to 1/150 rad errs by 1e-3. The half pixel at
    # a border is extrapolated; only the annular image is cut by one where it still shows something.
    assert difference.max() < (0.025 if source == "pal" else 0.012)
    assert np.sqrt((difference**2).mean()) < 1.5e-3


@pytest.mark.parametrize("channels", [(), (1,), (3,), (4,)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_identity_and_yaw_move_whole_pixels(channels: tuple[int, ...], dtype: type) -> None:
    image = np.random.default_rng(0).integers(0, 255, (256, 512, *channels)).astype(dtype)
    assert np.array_equal(Reprojector(ERP, ERP).image(image), image)
    for k in (1, 37, 256, 511):
        turned = Reprojector(ERP, ERP, look_rotation(360 * k / 512)).image(image)
        assert turned.shape == image.shape
        assert turned.dtype == image.dtype
        # Rays are computed in double precision; maps are single: a bilinear weight of 1e-4 may remain.
        assert np.abs(turned.astype(float) - np.roll(image, -k, axis=1)).max() < (0.1 if dtype == np.float32 else 1.1)


@pytest.mark.parametrize("view", sorted(VIEW_DIRECTIONS))
def test_seam_and_poles_are_no_edges(view: str) -> None:
    camera = PinholeCamera.from_fov(201, 80, 80)
    reprojector = Reprojector(ERP, camera, view_rotation(view))
    assert reprojector.valid.all()
    error = np.abs(reprojector.image(picture(ERP)) - picture(camera, view_rotation(view)))
    assert error.max() < 1e-3


def test_a_view_across_the_seam_uses_a_narrow_part_of_the_panorama() -> None:
    window = Reprojector(ERP, PinholeCamera.from_fov(100, 60, 60), view_rotation("back"))._maps.window
    assert window.x1 - window.x0 < 512 * 70 / 360
    assert window.y1 - window.y0 < 256 * 70 / 180


def test_cube_edges_are_no_edges() -> None:
    cube = CubemapCamera(1200, 200)
    camera = PinholeCamera.from_fov(200, 60, 60)
    for lon, lat in ((45, 0), (0, 45), (135, -35), (-45, 35.26), (180, 45), (90, -45)):
        R = look_rotation(lon, lat)
        error = np.abs(Reprojector(cube, camera, R).image(picture(cube)) - picture(camera, R))
        assert error.max() < 2e-3


def seen_by_pixels(camera: Camera, R: np.ndarray, rings: float, samples: int) -> np.ndarray:
    """The zone plate averaged over each pixel: what a sensor would record."""
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((camera.height, camera.width))
    for du in offsets:
        for dv in offsets:
            total += zone_plate(camera.unproject(camera.pixel_grid() + [du, dv]) @ R, rings)
    return total / samples**2


@pytest.mark.parametrize("factor", [3, 5, 11])
def test_zone_plate_does_not_alias(factor: int) -> None:
    """Rings finer than the target's pixels must turn grey, and those it can show must stay."""
    target = PinholeCamera.from_fov(64, 90, 90)
    pixel = 2 / 64  # radians, in the middle
    source = ErpCamera(2 * round(np.pi / pixel * factor), round(np.pi / pixel * factor))
    # Phase rings * angle^2; at 45 degrees one period is 2.5 source pixels, 2.5 / factor target pixels.
    rings = 2 * np.pi / (2.5 * pixel / factor) / (np.pi / 2)
    view = view_rotation("right")
    plate = zone_plate(source.rays(), rings).astype(np.float32)
    truth = seen_by_pixels(target, view, rings, samples=4 * factor)
    filtered, naive = (Reprojector(source, target, view, antialias).image(plate) for antialias in (True, False))
    assert np.sqrt(np.mean((filtered - truth) ** 2)) < 0.05
    if factor > 3:  # below, the target's edges are barely minified
        assert np.sqrt(np.mean((naive - truth) ** 2)) > 0.2
    # The innermost rings are several pixels wide and keep their contrast.
    centre = np.s_[26:38, 26:38]
    assert np.std(filtered[centre]) > 0.8 * np.std(truth[centre])


def test_one_sample_is_enough_when_magnifying() -> None:
    assert Reprojector(ERP, PinholeCamera.from_fov(400, 90, 90)).sampling.grid == 1
    assert Reprojector(ErpCamera(2048, 1024), ErpCamera(512, 256)).sampling.grid > 1


def test_anti_aliasing_keeps_brightness() -> None:
    reprojector = Reprojector(ErpCamera(1024, 512), ErpCamera(128, 64), ODD)
    assert reprojector.sampling.grid > 1
    for value in (0, 1, 77, 255):
        assert (reprojector.image(np.full((512, 1024, 3), value, np.uint8)) == value).all()


def test_valid_pixels_are_those_the_source_sees() -> None:
    pal = CAMERAS["pal"]
    up = view_rotation("up")
    reprojector = Reprojector(pal, ERP, up.T)
    # Wholly covered pixels lie inside the mask by half a source pixel and half their own; compare with the centres.
    pixels, seen = pal.project(ERP.rays() @ up.T)
    inside = np.zeros_like(seen)
    inside[seen] = pal.valid_mask()[pixels[seen][:, 1].astype(int), pixels[seen][:, 0].astype(int)]
    assert not (reprojector.valid & ~inside).any()
    assert (inside & ~reprojector.valid).sum() < 0.06 * inside.sum()
    image = reprojector.image(np.full((pal.height, pal.width, 3), 200, np.uint8))
    assert (image[reprojector.valid] == 200).all()
    assert (image[~reprojector.valid] == 0).all()
    rows = np.flatnonzero(reprojector.valid.any(axis=1))
    latitudes = 90 - np.array([rows[0], rows[-1] + 1]) * 180 / 256
    assert latitudes == pytest.approx([53, -27.5], abs=1.5)


def test_masks_shrink_rather_than_grow() -> None:
    mask = np.ones((256, 512), dtype=bool)
    mask[100:140, 300:360] = False
    camera = PinholeCamera.from_fov(240, 100, 80)
    R = look_rotation(50)
    reprojector = Reprojector(ERP.with_mask(mask), camera, R)
    shown = Reprojector(ERP, camera, R).image(mask.astype(np.float32))
    assert np.array_equal(reprojector.valid, shown > 0.999)
    assert np.array_equal(Reprojector(ERP, camera, R).mask(mask), reprojector.valid)
    assert 0 < (~reprojector.valid).mean() < 0.3


def test_the_targets_own_limits_count() -> None:
    target = ErpCamera(512, 256, hfov_deg=120, lat_min_deg=-30, lat_max_deg=30)
    reprojector = Reprojector(ERP, target)
    assert np.array_equal(reprojector.valid, target.valid_mask())
    assert (reprojector.image(np.full((256, 512, 3), 9, np.uint8))[~target.valid_mask()] == 0).all()


def test_radial_depth_stays_radial() -> None:
    """A sphere around the camera has one radial depth in every camera."""
    for name, camera in CAMERAS.items():
        depth = np.full((256, 512), 3.5, np.float32)
        reprojector = Reprojector(ERP, camera, ODD)
        out = reprojector.depth(depth)
        assert out.dtype == np.float32
        assert np.allclose(out[reprojector.valid], 3.5, rtol=1e-6), name
        assert np.isnan(out[~reprojector.valid]).all()


def test_depth_of_a_plane() -> None:
    """The wall z = 2 m: radial depth 2 / cos(angle to it), whatever the camera."""

    def wall(camera: Camera, R: np.ndarray) -> np.ndarray:
        z = (camera.rays() @ R)[..., 2]
        return np.where(z > 0.3, 2 / np.maximum(z, 0.3), np.nan).astype(np.float32)

    target = PinholeCamera.from_fov(200, 90, 60)
    R = look_rotation(10, -5)
    out = Reprojector(ERP, target, R).depth(wall(ERP, np.eye(3)))
    truth = wall(target, R)
    assert np.isfinite(out).all()
    assert np.abs(out / truth - 1).max() < 1e-3


@pytest.mark.parametrize("method", ["nearest", "edge-aware"])
def test_no_depth_between_two_surfaces(method: str) -> None:
    rng = np.random.default_rng(1)
    depth = np.where(rng.uniform(size=(256, 512)) < 0.5, 1.0, 5.0).astype(np.float32)
    out = Reprojector(ERP, PinholeCamera.from_fov(300, 90, 90), ODD).depth(depth, method)  # type: ignore[arg-type]
    assert np.minimum(np.abs(out - 1), np.abs(out - 5)).max() < 1e-5
    assert 0.4 < (out < 3).mean() < 0.6


def test_unknown_depth_does_not_spread() -> None:
    depth = np.full((256, 512), 2.0, np.float32)
    depth[120:130, 250:260] = np.nan
    out = Reprojector(ERP, ERP, look_rotation(360 * 0.5 / 512)).depth(depth)
    unknown = np.argwhere(np.isnan(out))
    assert 90 <= len(unknown) <= 110
    assert np.allclose(out[np.isfinite(out)], 2, rtol=1e-6)


def test_poses_and_pixels_agree() -> None:
    """A world point seen at a pixel of the source is seen at the mapped pixel of the target."""
    rng = np.random.default_rng(2)
    T_source = make_pose(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    target = CAMERAS["fisheye"]
    reprojector = Reprojector(ERP, target, ODD)
    T_target = reprojector.poses(np.stack([T_source, T_source]))[1]
    assert np.array_equal(T_target[:3, 3], T_source[:3, 3])
    world = rng.normal(size=(50, 3)) * 3
    in_source = (invert_pose(T_source) @ np.c_[world, np.ones(50)].T).T[:, :3]
    in_target = (invert_pose(T_target) @ np.c_[world, np.ones(50)].T).T[:, :3]
    assert np.allclose(in_target, in_source @ ODD.T)
    # And in the images: u is the picture, so the value at the projected pixel is the picture's at the ray.
    pixels, valid = target.project(in_target)
    image = reprojector.image(picture(ERP))
    rays = in_source / np.linalg.norm(in_source, axis=1, keepdims=True)
    for (u, v), ray in zip(pixels[valid], rays[valid]):
        assert np.abs(image[int(v), int(u)] - smooth(ray)).max() < 0.05


def test_no_overlap_names_both_fields_of_view() -> None:
    camera = PinholeCamera.from_fov(100, 60, 40)
    with pytest.raises(UnsupportedError) as caught:
        Reprojector(camera, camera, view_rotation("back"))
    message = str(caught.value)
    assert "longitude -30..30, latitude -20..20" in message
    assert "longitude 150..210" in message
    with pytest.raises(UnsupportedError, match="sees nothing"):
        Reprojector(CAMERAS["pal"], PinholeCamera.from_fov(100, 40, 40))  # into the blind centre
    lens = builtin_calibration("palvio_up").scaled(160)  # looks up, so that its own axes would tell a user little
    with pytest.raises(UnsupportedError, match=r"pal\) covers .* latitude -27\.\.52 .* latitude -90\.\.-6\d deg"):
        Reprojector(lens, PinholeCamera.from_fov(100, 40, 40), view_rotation("down") @ upright_rotation(lens))


def test_wrong_input_is_said() -> None:
    reprojector = Reprojector(ERP, CAMERAS["fisheye"])
    with pytest.raises(UnsupportedError, match="the image is 100x50, its camera 512x256"):
        reprojector.image(np.zeros((50, 100, 3), np.uint8))
    with pytest.raises(UnsupportedError, match="the depth is"):
        reprojector.depth(np.zeros((50, 100), np.float32))
    with pytest.raises(CalibrationError, match="rotation"):
        Reprojector(ERP, ERP, 2 * np.eye(3))
    with pytest.raises(CalibrationError, match="rotation"):
        Reprojector(ERP, ERP, np.diag([1.0, 1.0, -1.0]))

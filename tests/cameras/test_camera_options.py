"""What users type after `--camera` and `--to`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.cameras.calibration import builtin_calibration, write_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import camera_from_dict, parse_camera_option, parse_fov, upright_rotation
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.views import (
    PAPER_VIEWS,
    VIEW_DIRECTIONS,
    look_rotation,
    paper_views,
    rotated_poses,
    view_rotation,
)
from panobench.errors import CalibrationError, UnknownNameError, UnsupportedError, UsageError

ERP = ErpCamera(1024, 512)
PAL = builtin_calibration("palvio_up")


def test_own_camera_is_itself() -> None:
    choice = parse_camera_option("erp", ERP)
    assert choice.camera is ERP
    assert np.array_equal(choice.R_target_source, np.eye(3))
    assert parse_camera_option("pal", PAL).camera is PAL
    assert parse_camera_option("erp", ERP, 256).camera == ErpCamera(256, 128)


@pytest.mark.parametrize("view", sorted(VIEW_DIRECTIONS))
def test_views_of_a_panorama(view: str) -> None:
    camera, R, label = parse_camera_option(f"pinhole:{view}", ERP, 480)
    assert isinstance(camera, PinholeCamera)
    assert camera.fov_deg == pytest.approx((120, 60))
    assert (camera.width, label) == (480, f"pinhole-{view}")
    assert np.linalg.det(R) == pytest.approx(1)
    looks_at = R.T @ [0, 0, 1]
    lon, lat = np.deg2rad(VIEW_DIRECTIONS[view])
    assert looks_at == pytest.approx([np.sin(lon) * np.cos(lat), -np.sin(lat), np.cos(lon) * np.cos(lat)])
    # Level views keep the horizon level: down stays down.
    assert view in ("up", "down") or pytest.approx([0, 1, 0]) == R @ [0, 1, 0]


def test_panorama_of_an_annular_lens_stands_upright() -> None:
    """An ERP ray (x, y, z) is (x, z, -y) in the upward-looking lens."""
    choice = parse_camera_option("erp", PAL)
    assert choice.camera == ErpCamera(1024, 512)
    ray = np.array([0.3, -0.5, 0.8])
    assert choice.R_target_source.T @ ray == pytest.approx([0.3, 0.8, 0.5])
    front = parse_camera_option("pinhole:front", PAL)
    assert front.R_target_source == pytest.approx(choice.R_target_source)
    back_again = parse_camera_option("pal", ERP)
    assert back_again.camera == PAL
    assert back_again.R_target_source == pytest.approx(choice.R_target_source.T)
    assert upright_rotation(PAL) @ [0, 0, 1] == pytest.approx([0, -1, 0])  # the lens looks up


def test_default_widths_keep_the_resolution() -> None:
    per_radian = 1024 / (2 * np.pi)
    pinhole = parse_camera_option("pinhole", ERP).camera
    assert isinstance(pinhole, PinholeCamera)
    assert pinhole.fx == pytest.approx(per_radian, rel=0.35)
    fisheye = parse_camera_option("fisheye", ERP).camera
    assert isinstance(fisheye, KannalaBrandtCamera)
    assert fisheye.fx == pytest.approx(per_radian, rel=0.35)
    assert fisheye.fov_deg == 190
    cube = parse_camera_option("cubemap", ERP).camera
    assert cube.height / 2 == pytest.approx(per_radian, rel=0.35)
    assert parse_camera_option("erp", cube).camera == ERP


def test_field_of_view() -> None:
    assert parse_fov(None) is None
    assert parse_fov("120") == (120, None)
    assert parse_fov("120x60") == (120, 60)
    assert parse_fov(200) == (200, None)
    assert parse_fov((90, 60)) == (90, 60)
    for bad in ("wide", "120x", "120x60x3", "-5", "400", "nan"):
        with pytest.raises(UsageError, match="120x60"):
            parse_fov(bad)
    assert parse_camera_option("erp", ERP, fov="120").camera == ErpCamera(1024, 512, 120)
    assert parse_camera_option("erp", ERP, fov="200x90").camera == ErpCamera(1024, 512, 200, -45, 45)
    camera = parse_camera_option("pinhole:left", ERP, 400, "90x60").camera
    assert isinstance(camera, PinholeCamera)
    assert camera.fov_deg == pytest.approx((90, 60))
    assert parse_camera_option("fisheye:up", ERP, 300, "220").camera == KannalaBrandtCamera.equidistant(300, 220)


@pytest.mark.parametrize(
    ("option", "source", "width", "fov", "error", "message"),
    [
        ("epr", ERP, None, None, UnknownNameError, "did you mean 'erp'"),
        ("pinhole:lft", ERP, None, None, UnknownNameError, "did you mean 'left'"),
        ("pinhole", ERP, None, "200", UnsupportedError, "less than 180"),
        ("ds", ERP, None, None, UnsupportedError, "calibration file"),
        ("cubemap", ERP, None, "120", UsageError, "no field of view"),
        ("cubemap", ERP, 100, None, UsageError, "multiple of 6"),
        ("erp", PAL, 101, None, UsageError, "even"),
        ("fisheye", ERP, None, "190x100", UsageError, "cone"),
        ("pal", ERP, None, "120", UsageError, "calibration"),
        ("pinhole:400,95", ERP, None, None, UsageError, "latitude"),
        ("missing.yaml", ERP, None, None, CalibrationError, "missing.yaml: the calibration file is missing"),
    ],
)
def test_options_that_make_no_sense(
    option: str, source: ErpCamera, width: int | None, fov: str | None, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        parse_camera_option(option, source, width, fov)


def test_a_calibration_file_as_target(tmp_path: Path) -> None:
    path = tmp_path / "lens.yaml"
    write_calibration(PAL, path)
    camera, R, label = parse_camera_option(str(path), ERP, 640)
    assert (camera.kind, camera.width, label) == ("pal", 640, "lens")
    assert pytest.approx(upright_rotation(PAL).T) == R


def test_any_direction() -> None:
    _, R, label = parse_camera_option("pinhole:30,-20", ERP)
    assert pytest.approx(look_rotation(30, -20)) == R
    assert label == "pinhole-30,-20"
    # Right of the view stays horizontal; a roll turns clockwise, so the scene turns the other way.
    assert R[0, 1] == pytest.approx(0)
    assert np.array_equal(view_rotation("0,0,180"), np.diag([-1.0, -1.0, 1.0]))
    assert look_rotation(0, 0, 90) @ [0, -1, 0] == pytest.approx([-1, 0, 0])


def test_the_papers_views() -> None:
    views = paper_views(480)
    assert tuple(v.name for v in views) == PAPER_VIEWS == ("front", "left", "right")
    assert all((v.camera.width, v.camera.height) == (480, 160) for v in views)
    # Sideways views see what is at +-90 degrees of longitude.
    for view, lon in zip(views, (0, -90, 90)):
        ray = [np.sin(np.deg2rad(lon)), 0, np.cos(np.deg2rad(lon))]
        assert view.camera.project(view.R_target_source @ ray)[0] == pytest.approx([240, 80])


def test_rotated_poses() -> None:
    T = np.eye(4)
    T[:3, 3] = [1, 2, 3]
    turned = rotated_poses(T, view_rotation("right"))
    assert turned[:3, 3] == pytest.approx([1, 2, 3])
    assert turned[:3, :3] @ [0, 0, 1] == pytest.approx([1, 0, 0])  # looks along the old x axis


def test_camera_tables_that_are_none() -> None:
    for values in ([], {}, {"model": 3}, {"model": "nothing"}):
        with pytest.raises(CalibrationError):
            camera_from_dict(values)  # type: ignore[arg-type]

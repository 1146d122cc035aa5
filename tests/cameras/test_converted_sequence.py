"""A sequence seen through another camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sphere_images import picture

from panobench.cameras.base import Camera
from panobench.cameras.calibration import builtin_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import parse_camera_option
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.views import view_rotation
from panobench.datasets.base import FrameSequence
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.errors import UnsupportedError
from panobench.geometry import make_pose, so3_exp
from panobench.types import Imu, NovelView, Trajectory


class Toy(FrameSequence):
    """Three frames of a fixed picture, 3 m away all around."""

    name, dataset = "toy", "test"

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.times = np.array([0.0, 0.5, 1.0])
        self.T_body_cam: NDArray[np.float64] | None = make_pose(so3_exp([0.1, 0.2, 0.3]), [1.0, 0, 0])
        rng = np.random.default_rng(0)
        self.truth = Trajectory(self.times, make_pose(so3_exp(rng.normal(size=(3, 3))), rng.normal(size=(3, 3))))

    def image(self, index: int) -> NDArray[np.uint8]:
        return (picture(self.camera) * 255).round().astype(np.uint8)

    def frame_name(self, index: int) -> str:
        return f"frame {index}"

    def depth(self, index: int) -> NDArray[np.float32] | None:
        return np.full((self.camera.height, self.camera.width), 3.0, np.float32) if index == 1 else None

    @property
    def groundtruth(self) -> Trajectory:
        return self.truth

    @property
    def imu(self) -> Imu:
        return Imu(self.times, np.zeros((3, 3)), np.ones((3, 3)), self.T_body_cam)

    def novel_views(self) -> list[NovelView]:
        small = ErpCamera(128, 64)
        other = PinholeCamera.from_fov(40, 60, 60)
        views = [("own", self.camera), ("small", small), ("again", small), ("other", other)]
        return [NovelView(n, (picture(c) * 255).astype(np.uint8), c, self.truth.T_wc[0]) for n, c in views]

    def provenance(self) -> dict[str, Any]:
        return {"root": "nowhere"}


ERP = ErpCamera(256, 128)


def test_everything_moves_into_the_new_camera() -> None:
    source = Toy(ERP)
    camera, R, _ = parse_camera_option("pinhole:left", ERP, 120)
    converted = ConvertedSequence(source, camera, R)
    assert converted.camera == camera
    assert len(converted) == 3
    assert converted.frame_name(2) == "frame 2"
    image = converted.image(0)
    assert (image.shape, image.dtype) == ((40, 120, 3), np.dtype(np.uint8))
    assert np.abs(image / 255 - picture(camera, R)).max() < 0.012
    assert [f.index for f in converted.frames()] == [0, 1, 2]
    assert converted.depth(0) is None
    depth = converted.depth(1)
    assert depth is not None
    assert np.allclose(depth, 3, rtol=1e-6)
    truth = converted.groundtruth
    assert truth is not None
    assert np.array_equal(truth.times, source.times)
    assert np.allclose(truth.T_wc, source.truth.T_wc @ make_pose(R.T, np.zeros(3)))
    # The body does not move: body pose = camera pose times the inverse of T_body_cam. None: body and camera are one.
    for T_body_cam in (source.T_body_cam, None):
        source.T_body_cam = T_body_cam
        imu = converted.imu
        assert imu is not None
        assert imu.T_body_cam is not None
        body = source.truth.T_wc @ (np.eye(4) if T_body_cam is None else np.linalg.inv(T_body_cam))
        assert np.allclose(truth.T_wc @ np.linalg.inv(imu.T_body_cam), body)
    assert converted.provenance()["root"] == "nowhere"
    assert converted.provenance()["conversion"]["camera"]["model"] == "pinhole"


def test_novel_views_follow() -> None:
    camera, R, _ = parse_camera_option("pinhole:left", ERP, 120)
    converted = ConvertedSequence(Toy(ERP), camera, R)
    views = {v.name: v for v in converted.novel_views()}
    assert set(views) == {"own", "small", "again", "other"}
    assert views["own"].camera == views["small"].camera == camera
    assert np.abs(views["small"].image / 255 - picture(camera, R)).max() < 0.03
    assert np.allclose(views["own"].T_wc, converted.groundtruth.T_wc[0])  # type: ignore[union-attr]
    assert views["other"].camera == PinholeCamera.from_fov(40, 60, 60)  # another camera's picture stays
    assert converted.novel_views()[0] is views["own"]


def test_what_the_source_does_not_see_is_masked() -> None:
    pal = builtin_calibration("palvio_up").scaled(320)
    camera, R, _ = parse_camera_option("erp", pal, 256)
    converted = ConvertedSequence(Toy(pal), camera, R)
    valid = converted.camera.valid_mask()
    assert converted.camera.mask is not None
    assert 0.35 < valid.mean() < 0.47
    assert (converted.image(0)[~valid] == 0).all()
    assert np.isnan(converted.depth(1)[~valid]).all()  # type: ignore[index]
    # And back: only what both saw.
    again = ConvertedSequence(converted, pal, R.T)
    assert (again.camera.valid_mask() <= pal.valid_mask()).all()
    difference = np.abs(again.image(0).astype(float) - Toy(pal).image(0))[again.camera.valid_mask()]
    assert difference.mean() < 1.5


def test_a_limited_field_of_view_is_a_conversion_too() -> None:
    camera, R, _ = parse_camera_option("erp", ERP, fov="120")
    converted = ConvertedSequence(Toy(ERP), camera, R)
    assert converted.camera == camera  # no mask beside the model's own limit
    valid = camera.valid_mask()
    assert np.array_equal(converted.image(0)[valid], Toy(ERP).image(0)[valid])
    assert (converted.image(0)[~valid] == 0).all()


def test_a_narrow_view_that_loses_its_pixels_in_a_panorama_is_said() -> None:
    narrow = PinholeCamera.from_fov(256, 100, 84)
    (said,) = ConvertedSequence(Toy(narrow), ERP).remarks()
    assert "takes 70 of the panorama's 256 columns, its pictures have 256; --camera pinhole" in said
    assert ConvertedSequence(Toy(PinholeCamera.from_fov(100, 100, 84)), ERP).remarks() == []  # no more pixels than that
    pal = builtin_calibration("palvio_up").scaled(640)
    assert ConvertedSequence(Toy(pal), ERP).remarks() == []  # all around


def test_an_enlarged_image_is_known_as_one() -> None:
    double, half = (ConvertedSequence(Toy(ERP), ERP.scaled(width)) for width in (2 * ERP.width, ERP.width // 2))
    assert double.enlargement == pytest.approx(2.0, rel=0.02)
    assert half.enlargement == 1.0
    assert ConvertedSequence(double, ERP).enlargement == pytest.approx(1.0, rel=0.02)  # enlarged, and shrunk again


def test_no_overlap_is_refused() -> None:
    narrow = PinholeCamera.from_fov(60, 60, 40)
    with pytest.raises(UnsupportedError, match="sees nothing"):
        ConvertedSequence(Toy(narrow), narrow, view_rotation("back"))

"""Calibration files: round trips of every format, and what single formats say."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from camera_strategies import EXAMPLES, PALVIO_INVERSE, QUICK, STRATEGIES
from hypothesis import given, settings

from panobench.cameras.base import Camera
from panobench.cameras.calibration import (
    WRITTEN,
    builtin_calibration,
    inspect_calibration,
    read_calibration,
    write_calibration,
)
from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError, InputWarning, UnsupportedError

#: What each format can hold.
HOLDS = {
    "panobench": set(STRATEGIES),
    "kalibr": {"pinhole", "fisheye", "omni", "eucm", "ds"},
    "lfvio": {"pal", "pinhole", "fisheye", "omni"},
    "ocamcalib": {"pal"},
    "colmap": {"erp", "pinhole", "fisheye", "eucm"},
}
SUFFIX = {"ocamcalib": ".txt", "colmap": ".txt"}


def same_view(a: Camera, b: Camera) -> None:
    """Both project alike, to rounding of the file's numbers."""
    assert (a.width, a.height) == (b.width, b.height)
    points = np.random.default_rng(0).normal(size=(500, 3))
    (u, ok), (v, also) = a.project(points), b.project(points)
    assert (ok == also).mean() > 0.99
    assert np.abs(u - v)[ok & also].max(initial=0) < 1e-6


@pytest.mark.parametrize(("format", "model"), [(f, m) for f in HOLDS for m in sorted(HOLDS[f])])
def test_what_is_written_is_read(tmp_path: Path, format: str, model: str) -> None:
    path = tmp_path / f"camera{SUFFIX.get(format, '.yaml')}"

    @settings(QUICK, max_examples=10)
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        if (format, model) == ("colmap", "erp"):
            camera = ErpCamera(camera.width, camera.height)  # COLMAP has no limited field of view
        if len(getattr(camera, "distortion", ())) > 4 and format in ("kalibr", "lfvio"):
            with pytest.raises(UnsupportedError, match="four distortion coefficients"):
                write_calibration(camera, path, format)
            return
        write_calibration(camera, path, format)
        found = inspect_calibration(path)
        assert found.format == format
        if format == "panobench":
            assert found.camera == camera
        elif isinstance(camera, ScaramuzzaCamera):  # these files say nothing of where the polynomials hold
            same_view(found.camera.with_mask(None), dataclasses.replace(camera, r_min=0.0, r_max=None))
        elif isinstance(camera, KannalaBrandtCamera):
            same_view(found.camera, dataclasses.replace(camera, fov_deg=360.0))
        else:
            same_view(found.camera, camera)

    check()


@pytest.mark.parametrize("format", sorted(WRITTEN))
def test_models_a_format_does_not_have(tmp_path: Path, format: str) -> None:
    for model in set(STRATEGIES) - HOLDS[format]:
        camera = builtin_calibration("palvio_up") if model == "pal" else EXAMPLES[model]
        with pytest.raises(UnsupportedError, match=model):
            write_calibration(camera, tmp_path / "x", format)
        assert list(tmp_path.iterdir()) == []


LFVIO = """%YAML:1.0
---
imu_topic: "/mavros/imu/data"
model_type: scaramuzza
camera_name: pal
image_width: 1280
image_height: 960
poly_parameters:
   p0: -2.445239e+02
   p1: 0.000000e+00
   p2: 1.748610e-03
   p3: -1.757770e-06
   p4: 4.475965e-09
inv_poly_parameters:
{inverse}
affine_parameters:
   ac: 1.000000
   ad: 0.000000
   ae: 0.000000
   cx: 645.107791
   cy: 486.025172
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [-1.0, 0.0, 0.0,
           0.0,-1.0, 0.0,
           0.0, 0.0, 1.0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [0.0,0.0,0.03]
center_x: 640.991301
center_y: 490.937512
max_r: 500
min_r: 160
td: -0.008
"""


def test_lfvio_config(tmp_path: Path) -> None:
    path = tmp_path / "mindvision.yaml"
    path.write_text(LFVIO.format(inverse="\n".join(f"   p{i}: {q}" for i, q in enumerate([*PALVIO_INVERSE, 0.0, 0.0]))))
    found = inspect_calibration(path)
    assert found.format == "lfvio"
    assert found.camera == builtin_calibration("palvio_up")  # the ring included
    assert found.time_offset_s == -0.008
    assert found.body_T_cam is not None
    assert found.body_T_cam[:3, 3] == pytest.approx([0, 0, 0.03])
    assert np.diag(found.body_T_cam) == pytest.approx([-1, -1, 1, 1])


KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  distortion_model: radtan
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  T_cam_imu:
  - [0.01779318, 0.99967549,-0.01822936, 0.07008565]
  - [-0.9998017, 0.01795239, 0.00860714,-0.01771023]
  - [0.00893160, 0.01807260, 0.99979678, 0.00399246]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -8.121e-05
  resolution: [752, 480]
cam1:
  camera_model: omni
  intrinsics: [0.80065662, 833.006, 830.345, 373.850, 253.749]
  distortion_model: radtan
  distortion_coeffs: [-0.33518750, 0.13211436, 0.00055967, 0.00057686]
  resolution: [752, 480]
"""


def test_kalibr_chain(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    with pytest.warns(InputWarning, match="cam0 is taken; choose with camchain.yaml#cam1"):
        first = inspect_calibration(path)
    assert first.camera.to_dict()["fx"] == 461.629
    assert first.camera.to_dict()["cx"] == pytest.approx(363.18)
    assert first.time_offset_s == -8.121e-05
    assert any("cam1" in note for note in first.notes)
    # Kalibr's T_cam_imu takes points from the body to the camera; here the camera's pose on the body.
    assert first.body_T_cam is not None
    assert first.body_T_cam[:3, :3] @ [0.07008565, -0.01771023, 0.00399246] == pytest.approx(
        -first.body_T_cam[:3, 3], abs=1e-6
    )
    omni = read_calibration(path, camera="cam1")
    assert (omni.kind, omni.to_dict()["xi"]) == ("omni", 0.80065662)
    with pytest.raises(CalibrationError, match="did you mean 'cam1'"):
        read_calibration(path, camera="cam2")


@pytest.mark.parametrize(
    ("model", "intrinsics", "lens", "k", "kind"),
    [
        ("pinhole", [200, 201, 320, 240], "equidistant", [0.01, 0.002, 0, 0], "fisheye"),
        ("eucm", [0.6, 1.1, 200, 201, 320, 240], "none", [], "eucm"),
        ("ds", [-0.2, 0.59, 200, 201, 320, 240], "none", [], "ds"),
        ("ds", [-0.2, 0.59, 200, 201, 320, 240], "radtan", [0, 0, 0, 0], "ds"),
        ("pinhole", [200, 201, 320, 240], "none", [], "pinhole"),
    ],
)
def test_kalibr_models(
    tmp_path: Path, model: str, intrinsics: list[float], lens: str, k: list[float], kind: str
) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(
        f"cam0: {{camera_model: {model}, intrinsics: {intrinsics}, distortion_model: {lens}, "
        f"distortion_coeffs: {k}, resolution: [640, 480]}}\n"
    )
    camera = read_calibration(path, "kalibr")
    assert camera.kind == kind
    assert camera.to_dict()["cx"] == 320.5
    if kind == "ds":
        assert (camera.to_dict()["xi"], camera.to_dict()["alpha"]) == (-0.2, 0.59)


def test_colmap_cameras(tmp_path: Path) -> None:
    path = tmp_path / "cameras.txt"
    path.write_text(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 3\n1 SIMPLE_RADIAL 1920 1080 1500 960 540 -0.05\n"
        "2 EQUIRECTANGULAR 2048 1024 2048 1024\n7 OPENCV_FISHEYE 640 480 150 151 320 240 0.01 0.02 0 0\n"
    )
    assert read_calibration(path, camera="1").to_dict()["distortion"] == [-0.05, 0, 0, 0]
    assert read_calibration(path, camera="2").to_dict()["model"] == "erp"
    assert read_calibration(path, camera="7").to_dict()["k"] == [0.01, 0.02, 0, 0]
    path.write_text("1 PINHOL 640 480 1 1 1 1\n")
    with pytest.raises(CalibrationError, match=r"cameras.txt:1: .*did you mean 'PINHOLE'"):
        read_calibration(path)
    path.write_text("# x\n1 PINHOLE 640 480 1 1 1\n")
    with pytest.raises(CalibrationError, match=r":2: PINHOLE has 4 parameters .* found 3"):
        read_calibration(path)


@pytest.mark.parametrize(
    "text",
    [
        "{model: erp, width: 64, height: 32}\n",
        "{width: 64,\n height: 32,\n model: erp}\n",
        '# remark\n---\n{"width": 64, "height": 32, "model": "erp"}\n',
        '"model": erp\n"width": 64\n"height": 32\n',
        "model : erp\nwidth : 64\nheight : 32\n",
    ],
)
def test_any_style_of_yaml_is_recognised(tmp_path: Path, text: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    found = inspect_calibration(path)
    assert (found.format, found.camera) == ("panobench", ErpCamera(64, 32))


def test_a_kalibr_chain_in_flow_style_is_not_taken_for_ours(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(
        "{cam0: {camera_model: pinhole, intrinsics: [50, 50, 32, 24], distortion_model: none, resolution: [64, 48]}}"
    )
    assert inspect_calibration(path).format == "kalibr"

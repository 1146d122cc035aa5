"""Calibration files of every format."""

from __future__ import annotations

import contextlib
import json
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from mutate import Material
from target import Parse, Target, text

from panobench.errors import PanobenchError


def _calibration(format: str) -> Callable[[Path], Parse]:
    def setup(folder: Path) -> Parse:
        from panobench.cameras.calibration import inspect_calibration

        if format == "panobench":
            cv2.imwrite(str(folder / "mask.png"), np.full((48, 64), 255, np.uint8))

        def parse(path: Path) -> None:
            for form in (format, None):
                with contextlib.suppress(PanobenchError) if form is None else contextlib.nullcontext():
                    camera = inspect_calibration(path, form).camera
                    camera.project(np.array([[0.1, 0.2, 1.0], [1.0, 0.0, -1.0]]))

        return parse

    return setup


def _written(format: str, words: str, extra: tuple[str, ...] = ()) -> Callable[[], Material]:
    """Every camera the format holds, small, as the package writes it."""

    def make() -> Material:
        from panobench.cameras.calibration import write_calibration
        from panobench.cameras.double_sphere import DoubleSphereCamera
        from panobench.cameras.erp import ErpCamera
        from panobench.cameras.eucm import EucmCamera
        from panobench.cameras.kannala_brandt import KannalaBrandtCamera
        from panobench.cameras.mei import MeiCamera
        from panobench.cameras.pinhole import PinholeCamera
        from panobench.cameras.scaramuzza import ScaramuzzaCamera

        k = (-0.2, 0.03, 1e-3, 1e-3)
        poly = tuple(p * (48 / 960) ** (1 - i) for i, p in enumerate((-244.5, 0.0, 1.75e-3, -1.76e-6, 4.48e-9)))
        cameras = [
            ErpCamera(64, 32),
            PinholeCamera(64, 48, 40, 41, 31, 25, k),
            KannalaBrandtCamera(64, 48, 20, 21, 31, 25, (0.02, -0.01, 0.004, -0.0008)),
            DoubleSphereCamera(64, 48, 20, 21, 31, 25, xi=-0.2, alpha=0.59),
            EucmCamera(64, 48, 20, 21, 31, 25, alpha=0.6, beta=1.1),
            MeiCamera(64, 48, 40, 41, 31, 25, xi=1.1, distortion=k),
            ScaramuzzaCamera(64, 48, poly, 32.5, 24.1, r_min=4.0, r_max=23.0),
        ]
        documents = [e.encode() for e in extra]
        with tempfile.TemporaryDirectory() as folder:
            for camera in cameras:
                path = Path(folder) / "camera.yaml"
                with contextlib.suppress(PanobenchError):
                    write_calibration(camera, path, format)
                    documents.append(path.read_bytes())
        return Material(tuple(documents), tuple(w.encode() for w in words.split()))

    return make


_PANOBENCH = """model: pinhole
width: 64
height: 48
fx: 40.0
fy: 41.0
cx: 31.0
cy: 25.0
mask: mask.png
annulus: {centre: [32.0, 24.0], r_min: 3, r_max: 22.5}
source: me
time_offset_s: -0.008
body_T_cam: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
_KALIBR = """cam0:
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.01]
  - [0.0, 1.0, 0.0, 0.02]
  - [0.0, 0.0, 1.0, -0.01]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [19.0, 19.1, 25.4, 25.6]
  resolution: [51, 52]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.002
cam1:
  camera_model: omni
  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]
  distortion_model: radtan
  intrinsics: [0.8, 19.0, 19.1, 25.4, 25.6]
  resolution: [51, 52]
"""
_LFVIO = """%YAML:1.0
---
model_type: scaramuzza
image_width: 64
image_height: 48
poly_parameters:
   p0: -12.2
   p1: 0.0
   p2: 0.035
   p3: -0.0007
   p4: 0.000036
affine_parameters: {ac: 1.0, ad: 0.001, ae: -0.002, cx: 32.0, cy: 24.1}
center_x: 32.1
center_y: 24.0
min_r: 4
max_r: 22
td: -0.008
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [0, 0, 1, -1, 0, 0, 0, -1, 0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [0.09, 0.0, -0.05]
"""
_OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
fisheye_model: 0
xi: !!opencv-matrix {rows: 1, cols: 1, dt: d, data: [1.1]}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 40., 0., 31.5, 0., 41., 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -2.0000000000000001e-01, 0.05, 0.001, -0.0005 ]
"""
_ROS = """image_width: 64
image_height: 48
camera_matrix: {rows: 3, cols: 3, data: [40.0, 0.0, 31.5, 0.0, 41.0, 23.5, 0.0, 0.0, 1.0]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.01, 0.002, -0.001, 0.0001]}
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0}
"""
_EUROC_SENSOR = """sensor_type: camera
T_BS: {rows: 4, cols: 4, data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0, 0, 0, 0, 1]}
resolution: [64, 48]
camera_model: pinhole
intrinsics: [40, 41, 31.5, 23.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.2, 0.05, 0.001, -0.0005]
"""
_STEREO = "M1: [[40,0,31],[0,41,23],[0,0,1]]\nM2: [[40,0,31],[0,41,23],[0,0,1]]\nD1: [0,0,0,0,0]\nsize: [64, 48]\n"
_OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>64</image_Width><image_Height>48</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>40. 0. 31.5 0. 41. 23.5 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>-0.2 0.05 0.001 -0.0005 0.01</data></Distortion_Coefficients>
<size><_>64</_><_>48</_></size>
</opencv_storage>
"""
_ORBSLAM = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera.width: 64
Camera.height: 48
""" + "".join(f"Camera{n}.{k}: {v}\n" for n in (1, 2) for k, v in zip(
    ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"), (20, 21.0, 31.5, 23.5, 0.01, 0.002, -0.001, 0.0001))) + """
IMU.T_b_c1: !!opencv-matrix {rows: 4, cols: 4, dt: f, data: [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]}
Stereo.T_c1_c2: !!opencv-matrix {rows: 4, cols: 4, dt: f, data: [1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]}
"""  # fmt: skip
_STELLA = """Camera:
  model: "fisheye"
  cols: 64
  rows: 48
  fx: 20
  fy: 21
  cx: 31.5
  cy: 23.5
  k1: 0.01
"""
_BASALT = json.dumps({"value0": {
    "T_imu_cam": [{"px": 0, "py": 0.1, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1}] * 2, "cam_time_offset_ns": 12,
    "intrinsics": [
        {"camera_type": "ds", "intrinsics": {"fx": 20, "fy": 21, "cx": 31, "cy": 25, "xi": -0.2, "alpha": 0.59}},
        {"camera_type": "kb4", "intrinsics": {"fx": 20, "fy": 21, "cx": 31, "cy": 25, "k1": 0.1, "k2": 0, "k3": 0,
                                              "k4": 0}},
    ], "resolution": [[64, 48], [64, 48]]}}, indent=1)  # fmt: skip
_TRANSFORMS = json.dumps(
    {
        "camera_model": "OPENCV",
        "w": 64,
        "h": 48,
        "fl_x": 40,
        "fl_y": 41,
        "cx": 32,
        "cy": 24,
        "k1": -0.1,
        "p1": 0.001,
        "frames": [
            {
                "file_path": f"images/{i}.png",
                "transform_matrix": [[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
            }
            for i in range(3)
        ],
    },
    indent=1,
)
_NGP = json.dumps({"camera_angle_x": 1.2, "w": 64, "h": 48, "frames": []})
_COLMAP_BINARY = (
    struct.pack("<QIiQQ8d", 3, 1, 5, 64, 48, 20, 21, 32, 24, 0.01, 0.002, -0.001, 0.0001)
    + struct.pack("<IiQQ2d", 2, 17, 64, 32, 64, 32) + struct.pack("<IiQQ4d", 7, 2, 64, 48, 40, 32, 24, -0.1)
)  # fmt: skip
_COLMAP = """# Camera list
1 OPENCV 64 48 40 41 32 24 -0.2 0.03 0.001 0.001
2 EQUIRECTANGULAR 64 32 64 32
3 SIMPLE_RADIAL_FISHEYE 64 48 20 32 24 0.01
4 EUCM 64 48 20 21 31 25 0.6 1.1
5 FULL_OPENCV 64 48 40 41 32 24 -0.2 0.03 0.001 0.001 0 0 0 0
"""

_YAML_WORDS = "model pinhole erp pal fisheye ds eucm omni cubemap width height fx cx k poly inv_poly r_min r_max mask "
_MODELS = "PINHOLE SIMPLE_PINHOLE RADIAL OPENCV FULL_OPENCV OPENCV_FISHEYE FISHEYE EUCM EQUIRECTANGULAR"


TARGETS = (
    Target(
        "ocamcalib", "calib_results.txt", _written("ocamcalib", "nan inf 5 0", (
            "5 -12.2 0 0.035 -0.0007 0.000036\n\n6 18.8 12.3 0.95 1.2 0.95 0.3\n\n24.1 32.2\n\n1 0 0\n\n48 64\n",
        )), _calibration("ocamcalib"),
    ),
    Target("kalibr", "camchain.yaml", _written("kalibr", "pinhole omni eucm ds none radtan equidistant cam0 cam1 "
           "camera_model intrinsics resolution T_cam_imu", (_KALIBR,)), _calibration("kalibr")),
    Target("lfvio", "lfvio.yaml", _written("lfvio", "scaramuzza PINHOLE MEI KANNALA_BRANDT p0 p5 p63 cx min_r max_r "
           "td data body_T_cam0 !!opencv-matrix", (_LFVIO,)), _calibration("lfvio")),
    Target("panobench-camera", "camera.yaml", _written("panobench", _YAML_WORDS, (_PANOBENCH,)),
           _calibration("panobench")),
    Target("colmap", "cameras.txt", _written("colmap", _MODELS, (_COLMAP,)), _calibration("colmap")),
    Target("colmap-binary", "cameras.bin", lambda: Material((_COLMAP_BINARY,), (b"\x11", b"\x05", b"\xff" * 8)),
           _calibration("colmap")),
    Target("opencv", "camera.yml", text(_OPENCV, _ROS, _EUROC_SENSOR, _STEREO, words="K D M1 D2 dist xi skew fisheye "
           "plumb_bob rational_polynomial omnidir !!opencv-matrix data rows T_BS size"), _calibration("opencv")),
    Target("opencv-xml", "camera.xml", text(_OPENCV_XML, words="<_> </_> <data> </data> <!DOCTYPE <!ENTITY &a; nan "
           "<xi>1</xi> type_id"), _calibration("opencv")),
    Target("slam-settings", "settings.yaml", text(_ORBSLAM, _STELLA, words="Camera Camera1.fx PinHole fisheye "
           "Rectified equirectangular perspective Camera.cols Tbc"), _calibration("slam-settings")),
    Target("basalt", "calibration.json", text(_BASALT, words='"ucm" "eucm" "pinhole" "pinhole-radtan8" "xi" "beta" '
           "null [] {}"), _calibration("basalt")),
    Target("nerfstudio-camera", "transforms.json", text(_TRANSFORMS, _NGP, words='"OPENCV_FISHEYE" "EQUIRECTANGULAR" '
           '"w" "k4" null [] {} 1e999'), _calibration("nerfstudio")),
)  # fmt: skip

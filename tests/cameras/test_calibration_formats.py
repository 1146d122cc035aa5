"""Calibration files of other programs: what they say, judged by OpenCV's own projection and by their own formulas."""

from __future__ import annotations

import json
import struct
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.calibration import calibration_file, inspect_calibration, read_calibration, write_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import parse_camera_option
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import CalibrationError, InputWarning, UnsupportedError

K = np.array([[500.0, 0, 319.5], [0, 501.0, 239.5], [0, 0, 1]])
RADTAN = np.array([-0.2, 0.05, 0.001, -0.0005, 0.01])
RATIONAL = np.array([0.3, -0.1, 0.001, -0.0005, 0.01, 0.35, -0.09, 0.005])
FISHEYE_K = np.array([[250.0, 0, 399.5], [0, 251.0, 398.5], [0, 0, 1]])
FISHEYE = np.array([0.01, 0.002, -0.001, 0.0001])
POINTS = np.random.default_rng(1).uniform(-0.5, 0.5, (200, 3)) + [0, 0, 1.2]


def pixels(camera: Camera) -> np.ndarray:
    """Where the camera sees POINTS, counted as OpenCV does."""
    found, valid = camera.project(POINTS)
    assert valid.mean() > 0.6
    return np.where(valid[:, None], found - 0.5, np.nan)


def agree(camera: Camera, expected: np.ndarray, tolerance: float = 1e-9) -> None:
    assert np.nanmax(np.abs(pixels(camera) - expected.reshape(-1, 2))) < tolerance


def radtan_pixels(K: np.ndarray, d: np.ndarray) -> np.ndarray:
    return cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, d)[0]


def fisheye_pixels(K: np.ndarray, d: np.ndarray) -> np.ndarray:
    return cv2.fisheye.projectPoints(POINTS[None], np.zeros(3), np.zeros(3), K, d)[0]


def store(path: Path, **values: Any) -> Path:
    """A file as cv2.FileStorage writes it; a name of cv2 becomes what it stands for."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        file.write(key, value)
    file.release()
    return path


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".xml", ".json"])
@pytest.mark.parametrize("d", [RADTAN, RATIONAL, np.r_[RATIONAL, np.zeros(4)]], ids=["five", "eight", "twelve"])
def test_opencv_pinhole(tmp_path: Path, suffix: str, d: np.ndarray) -> None:
    path = store(tmp_path / f"c{suffix}", image_width=640, image_height=480, camera_matrix=K, distortion_coefficients=d)
    found = inspect_calibration(path)
    assert (found.format, found.camera.kind, found.doubts) == ("opencv", "pinhole", [])
    agree(found.camera, radtan_pixels(K, d))


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
@pytest.mark.parametrize(
    "said", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}, {"camera_model": "fisheye"}]
)
def test_opencv_fisheye(tmp_path: Path, suffix: str, said: dict[str, Any]) -> None:
    path = store(tmp_path / f"c{suffix}", cameraMatrix=FISHEYE_K, distCoeffs=FISHEYE, imageSize=np.array([800, 800]),
                 **said)  # fmt: skip
    camera = read_calibration(path)
    assert isinstance(camera, KannalaBrandtCamera)
    agree(camera, fisheye_pixels(FISHEYE_K, FISHEYE))


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_opencv_omnidir(tmp_path: Path, suffix: str) -> None:
    """cv::omnidir: x/|x| + (0, 0, xi), divided by z, then four coefficients and the matrix (its documentation)."""
    xi, d = 1.2, np.array([-0.2, 0.05, 0.001, -0.0005])
    path = store(tmp_path / f"c{suffix}", camera_matrix=K, distortion_coefficients=d, xi=np.array([[xi]]),
                 image_width=640, image_height=480)  # fmt: skip
    camera = read_calibration(path)
    assert camera.kind == "omni"
    unit = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True) + [0, 0, xi]
    expected = cv2.projectPoints(unit, np.zeros(3), np.zeros(3), K, d)[0]
    agree(camera, expected)


def test_opencv_four_coefficients_without_a_word_are_doubted(tmp_path: Path) -> None:
    values = {"K": K, "D": RADTAN[:4], "image_width": 640, "image_height": 480}
    with pytest.warns(InputWarning, match="no word on the lens.*distortion_model: equidistant"):
        agree(read_calibration(store(tmp_path / "c.yml", **values)), radtan_pixels(K, RADTAN[:4]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        agree(read_calibration(store(tmp_path / "d.yml", **values, fisheye_model=0)), radtan_pixels(K, RADTAN[:4]))


def test_opencv_stereo(tmp_path: Path) -> None:
    path = store(tmp_path / "s.yml", M1=K, D1=RADTAN, M2=FISHEYE_K, D2=RADTAN / 2, image_width=640, image_height=480)
    with pytest.warns(InputWarning, match=r"the cameras 1, 2: 1 is taken; choose with s.yml#2"):
        agree(read_calibration(path), radtan_pixels(K, RADTAN))
    found, _ = read_calibration(f"{path}#2").project(POINTS)
    assert np.nanmin(np.abs(found - 0.5 - radtan_pixels(FISHEYE_K, RADTAN / 2).reshape(-1, 2))) < 1e-9


def test_plain_json_and_yaml_of_a_script(tmp_path: Path) -> None:
    values = {"K": K.tolist(), "dist": [RADTAN.tolist()], "img_size": None, "width": 640, "height": 480}
    (tmp_path / "c.json").write_text(json.dumps(values))
    agree(read_calibration(tmp_path / "c.json"), radtan_pixels(K, RADTAN))
    (tmp_path / "c.yaml").write_text(f"mtx: {K.tolist()}\ndist: {RADTAN.tolist()}\nresolution: [640, 480]\n")
    agree(read_calibration(tmp_path / "c.yaml"), radtan_pixels(K, RADTAN))


ROS = """image_width: 640
image_height: 480
camera_name: cam
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 319.5, 0.0, 501.0, 239.5, 0.0, 0.0, 1.0]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {n}
  data: {data}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [480, 0, 319, 0, 0, 480, 239, 0, 0, 0, 1, 0]}}
"""


@pytest.mark.parametrize(
    ("model", "d", "project"),
    [
        ("plumb_bob", RADTAN, radtan_pixels),
        ("plumb_bob", RADTAN[:4], radtan_pixels),
        ("rational_polynomial", RATIONAL, radtan_pixels),
        ("equidistant", FISHEYE, fisheye_pixels),
        ("fisheye", FISHEYE, fisheye_pixels),
    ],
)
def test_ros_camera_info(tmp_path: Path, model: str, d: np.ndarray, project: Any) -> None:
    path = tmp_path / "ost.yaml"
    path.write_text(ROS.format(model=model, n=len(d), data=d.tolist()))
    found = inspect_calibration(path)
    assert found.doubts == []
    agree(found.camera, project(K, d))
    # as `rostopic echo` and `ros2 topic echo` print the message
    for big in (True, False):
        keys = "DK" if big else "dk"
        path.write_text(
            f"header:\n  frame_id: cam\nheight: 480\nwidth: 640\ndistortion_model: {model}\n{keys[0]}: {d.tolist()}\n"
            f"{keys[1]}: {K.ravel().tolist()}\nbinning_x: 0\nroi: {{x_offset: 0, y_offset: 0, height: 0, width: 0}}\n"
        )
        agree(read_calibration(path), project(K, d))


def test_ros_camera_info_as_echoed(tmp_path: Path) -> None:
    path = tmp_path / "info.yaml"
    values = f"height: 480\nwidth: 640\ndistortion_model: plumb_bob\nD: {RADTAN.tolist()}\nK: {K.ravel().tolist()}\n"
    path.write_text(f"header:\n  seq: 1\n  stamp:\n    secs: 1\n    nsecs: 2\n{values}---\n")
    once = read_calibration(path)
    agree(once, cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, RADTAN)[0])
    path.write_text(path.read_text() * 3)
    assert read_calibration(path).to_dict() == once.to_dict()


def test_a_model_beside_a_camera_matrix_is_a_lens(tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    matrix = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": FISHEYE_K.ravel().tolist()}
    values = {"image_width": 800, "image_height": 800, "camera_matrix": matrix, "model": "fisheye"}
    path.write_text(json.dumps({**values, "distortion_coefficients": FISHEYE.tolist()}, indent=1))
    found = inspect_calibration(path)
    assert found.format == "opencv"
    agree(found.camera, cv2.fisheye.distortPoints(POINTS[:, None, :2] / POINTS[:, None, 2:], FISHEYE_K, FISHEYE))


def test_euroc_sensor(tmp_path: Path) -> None:
    (tmp_path / "sensor.yaml").write_text(
        "sensor_type: camera\ncomment: left\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0, -1, 0, -0.02, 1, 0, 0, -0.06,\n"
        "    0, 0, 1, 0.01, 0, 0, 0, 1]\nrate_hz: 20\nresolution: [640, 480]\ncamera_model: pinhole\n"
        f"intrinsics: [500, 501, 319.5, 239.5]\ndistortion_model: radial-tangential\n"
        f"distortion_coefficients: {RADTAN[:4].tolist()}\n"
    )
    found = inspect_calibration(tmp_path / "sensor.yaml")
    agree(found.camera, radtan_pixels(K, RADTAN[:4]))
    assert found.body_T_cam is not None
    assert found.body_T_cam[:3, 3].tolist() == [-0.02, -0.06, 0.01]


def test_orb_slam3(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    head = '%YAML:1.0\n# remark\nFile.version: "1.0"\nCamera.width: 640\nCamera.height: 480\nCamera.fps: 20\n'
    path.write_text(
        head + 'Camera.type: "PinHole"\nCamera1.fx: 500.0\nCamera1.fy: 501.0\nCamera1.cx: 319.5\nCamera1.cy: 239.5\n'
        "Camera1.k1: -0.2\nCamera1.k2: 0.05\nCamera1.p1: 0.001\nCamera1.p2: -0.0005\nCamera1.k3: 0.01\n"
        "IMU.T_b_c1: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: f\n   data: [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3,"
        " 0, 0, 0, 1]\n"
    )
    found = inspect_calibration(path)
    agree(found.camera, radtan_pixels(K, RADTAN))
    assert found.body_T_cam is not None
    assert found.body_T_cam[:3, 3].tolist() == [1, 2, 3]
    lens = "".join(f"Camera{n}.k{i + 1}: {k}\n" for n in (1, 2) for i, k in enumerate(FISHEYE))
    one, two = ("".join(f"Camera{n}.{k}: {v}\n" for k, v in zip(("fx", "fy", "cx", "cy"), (f, 251.0, 399.5, 398.5)))
                for n, f in ((1, 250.0), (2, 260.0)))  # fmt: skip
    path.write_text(
        head.replace("640", "800").replace("480", "800") + 'Camera.type: "KannalaBrandt8"\n' + one + two + lens
    )
    with pytest.warns(InputWarning, match="Camera1 is taken"):
        agree(read_calibration(path), fisheye_pixels(FISHEYE_K, FISHEYE))
    assert read_calibration(f"{path}#Camera2").to_dict()["fx"] == read_calibration(f"{path}#2").to_dict()["fx"] == 260.0
    # ORB-SLAM2, and ORB-SLAM3 before its settings had a version
    path.write_text(head + "Camera.fx: 500.0\nCamera.fy: 501.0\nCamera.cx: 319.5\nCamera.cy: 239.5\nCamera.k1: -0.1\n")
    agree(read_calibration(path), radtan_pixels(K, np.array([-0.1, 0, 0, 0])))


def test_stella(tmp_path: Path) -> None:
    path = tmp_path / "stella.yaml"
    path.write_text(
        'Camera:\n  name: "c"\n  setup: "monocular"\n  model: "equirectangular"\n  cols: 1920\n  rows: 960\n'
        'Feature:\n  name: "x"\n'
    )
    assert inspect_calibration(path).camera == ErpCamera(1920, 960)
    path.write_text('Camera.name: "c"\nCamera.model: "equirectangular"\nCamera.cols: 1920\nCamera.rows: 960\n')
    assert read_calibration(path) == ErpCamera(1920, 960)  # OpenVSLAM's flat keys
    numbers = "  fx: 250\n  fy: 251\n  cx: 399.5\n  cy: 398.5\n  k1: 0.01\n  k2: 0.002\n  k3: -0.001\n  k4: 0.0001\n"
    path.write_text(f'Camera:\n  model: "fisheye"\n  cols: 800\n  rows: 800\n{numbers}')
    agree(read_calibration(path), fisheye_pixels(FISHEYE_K, FISHEYE))
    path.write_text(f'Camera:\n  model: "radial_division"\n  cols: 800\n  rows: 800\n{numbers}')
    with pytest.raises(CalibrationError, match=r"stella.yaml:2: 'radial_division' is not known here"):
        read_calibration(path)


def test_basalt(tmp_path: Path) -> None:
    intrinsics: list[dict[str, Any]] = [
        {"camera_type": "ds", "intrinsics": {"fx": 158, "fy": 158.1, "cx": 254.9, "cy": 256.8, "xi": -0.17,
                                             "alpha": 0.59}},
        {"camera_type": "kb4", "intrinsics": {"fx": 250, "fy": 251, "cx": 399.5, "cy": 398.5,
                                              **{f"k{i + 1}": k for i, k in enumerate(FISHEYE)}}},
        {"camera_type": "pinhole-radtan8", "intrinsics": {
            "fx": 500, "fy": 501, "cx": 319.5, "cy": 239.5, "rpmax": 0,
            **dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), RATIONAL))}},
        {"camera_type": "ucm", "intrinsics": {"fx": 250, "fy": 250, "cx": 320, "cy": 240, "alpha": 0.6}},
    ]  # fmt: skip
    pose = {"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0, "qy": 0, "qz": np.sqrt(0.5), "qw": np.sqrt(0.5)}
    sizes = [[512, 512], [800, 800], [640, 480], [640, 480]]
    path = tmp_path / "calibration.json"
    values = {"T_imu_cam": [pose] * 4, "intrinsics": intrinsics, "resolution": sizes, "cam_time_offset_ns": -8000000}
    path.write_text(json.dumps({"value0": values}))
    with pytest.warns(InputWarning, match=r"cam0 is taken; choose with calibration.json#cam1"):
        first = inspect_calibration(path)
    assert first.time_offset_s == -0.008
    assert first.body_T_cam is not None
    assert first.body_T_cam[:3, 3] == pytest.approx([0.1, 0.2, 0.3])
    assert first.body_T_cam[:3, :3] @ [1, 0, 0] == pytest.approx([0, 1, 0])
    # Usenko, equation 40 onwards
    x, y, z = POINTS.T
    d1 = np.linalg.norm(POINTS, axis=1)
    k = -0.17 * d1 + z
    n = 0.59 * np.sqrt(x * x + y * y + k * k) + 0.41 * k
    agree(first.camera, np.stack([158 * x / n + 254.9, 158.1 * y / n + 256.8], axis=1))
    agree(read_calibration(f"{path}#cam1"), fisheye_pixels(FISHEYE_K, FISHEYE))
    agree(read_calibration(f"{path}#2"), radtan_pixels(K, RATIONAL))
    n = 0.6 * d1 + 0.4 * z  # the unified camera model in Basalt's parameters
    agree(read_calibration(f"{path}#cam3"), np.stack([250 * x / n + 320, 250 * y / n + 240], axis=1))


def test_nerfstudio(tmp_path: Path) -> None:
    """Pixel centres at 0.5: half a pixel more than OpenCV counts."""
    path = tmp_path / "transforms.json"
    values: dict[str, Any] = {"w": 800, "h": 800, "fl_x": 250, "fl_y": 251, "cx": 400, "cy": 399, "frames": []}
    lens = {f"k{i + 1}": k for i, k in enumerate(FISHEYE)}
    path.write_text(json.dumps({"camera_model": "OPENCV_FISHEYE", **values, **lens}))
    assert inspect_calibration(path).format == "nerfstudio"
    agree(read_calibration(path), fisheye_pixels(FISHEYE_K, FISHEYE))
    radial = {"k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.0005}
    path.write_text(json.dumps({"camera_model": "OPENCV", **values, **radial}))
    agree(read_calibration(path), radtan_pixels(FISHEYE_K, RADTAN[:4]))
    path.write_text(json.dumps({"camera_angle_x": 2 * np.arctan(400 / 250), "w": 800, "h": 800, "frames": []}))
    agree(read_calibration(path), radtan_pixels(np.array([[250.0, 0, 399.5], [0, 250, 399.5], [0, 0, 1]]), np.zeros(4)))
    path.write_text(json.dumps({"camera_model": "EQUIRECTANGULAR", "w": 1920, "h": 960, "frames": []}))
    assert read_calibration(path) == ErpCamera(1920, 960)
    own = {k: values.pop(k) for k in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    path.write_text(json.dumps({"camera_model": "OPENCV", "frames": [own, own]}))
    assert read_calibration(path) == PinholeCamera(800, 800, 250, 251, 400, 399)
    path.write_text(json.dumps({"camera_model": "OPENCV", "frames": [own, {**own, "fl_x": 2}]}))
    with pytest.raises(CalibrationError, match="different cameras"):
        read_calibration(path)


def test_colmap_binary(tmp_path: Path) -> None:
    path = tmp_path / "cameras.bin"
    fisheye = struct.pack("<IiQQ8d", 3, 5, 800, 800, 250, 251, 400, 399, *FISHEYE)
    panorama = struct.pack("<IiQQ2d", 9, 17, 1920, 960, 1920, 960)
    path.write_bytes(struct.pack("<Q", 2) + fisheye + panorama)
    with pytest.warns(InputWarning, match=r"the cameras 3, 9: 3 is taken; choose with cameras.bin#9"):
        agree(read_calibration(path), fisheye_pixels(FISHEYE_K, FISHEYE))
    assert read_calibration(f"{path}#9") == ErpCamera(1920, 960)
    same = fisheye[4:]
    path.write_bytes(struct.pack("<Q", 2) + struct.pack("<I", 1) + same + struct.pack("<I", 2) + same)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # COLMAP gives every image its own camera unless told otherwise
        agree(read_calibration(path), fisheye_pixels(FISHEYE_K, FISHEYE))
    path.write_bytes(struct.pack("<Q", 1) + struct.pack("<IiQQ5d", 1, 7, 64, 48, 1, 1, 1, 1, 1))
    with pytest.raises(CalibrationError, match="unknown COLMAP model 'FOV'"):
        read_calibration(path)
    path.write_bytes((struct.pack("<Q", 2) + fisheye + panorama)[:-3])
    with pytest.raises(CalibrationError, match="cut short"):
        read_calibration(path)


_K, _SIZE = "K: [9, 0, 2, 0, 9, 2, 0, 0, 1]\n", "width: 4\nheight: 4\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.yml", f"%YAML:1.0\n---\n{_K}", "image size is missing: add image_width"),
        ("c.yml", f"camera_matrix: [1, 0, 0, 0, 1, 0]\n{_SIZE}", "must have 3x3 numbers, not 6"),
        ("c.yml", f"K: [9, 0.3, 2, 0, 9, 2, 0, 0, 1]\n{_SIZE}", "a skew of 0.3 px is not read.*CALIB_FIX_SKEW"),
        ("c.yml", f"{_K}{_SIZE}D: [0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]\n", "thin prism"),
        ("c.yml", f"{_K}distortion_model: atan\n{_SIZE}", ":2: .*'atan' is not known"),
        ("c.yml", f"{_K}{_SIZE}binning_x: 2\n", "binned"),
        ("c.xml", "<opencv_storage><camera_matrix>", "not valid XML"),
        ("c.xml", "<!DOCTYPE x [<!ENTITY a 'b'>]><opencv_storage>&a;</opencv_storage>", "document type or entities"),
        ("c.xml", "<calibration><matrix/></calibration>", "opencv_storage.*not <calibration>"),
        ("c.xml", "<opencv_storage>" + "<a>" * 100 + "</a>" * 100 + "</opencv_storage>", "nested too deeply"),
        ("c.json", "{}", "not recognised"),
        ("c.json", '{"frames": [], "w": 4, "h": 4}', "'fl_x' is missing"),
        ("c.json", '{"frames": 3, "fl_x": 1e400}', "not valid JSON"),
        ("c.json", '{"intrinsics": [{"camera_type": "ds", "intrinsics": {}}], "resolution": [[4, 4]]}', "must have fx"),
        ("c.yaml", "Camera.fx: 1\nCamera.fy: 1\nCamera.cx: 1\nCamera.cy: 1\n", "missing: add Camera.width"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_calibration(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_formats_that_are_only_read(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="read, not written; pinhole cameras go to panobench"):
        write_calibration(PinholeCamera(64, 48, 40, 40, 32, 24), tmp_path / "c.json", "basalt")


def test_what_is_a_file_and_what_a_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("lens", "a:b.yaml", "c#1.yaml", "erp"):
        Path(name).write_text("model: pinhole\nwidth: 64\nheight: 48\nfx: 40\nfy: 40\ncx: 32\ncy: 24\n")
    for option in ("lens", "a:b.yaml", "c#1.yaml", "./erp", "missing.json", "calib.yaml#cam1", "x/y"):
        assert calibration_file(option) == option
    for option in ("erp", "pinhole:front", "pinhole:30,-20.5", "nothing"):
        assert calibration_file(option) is None
    for option in ("lens", "a:b.yaml", "c#1.yaml", "./erp"):
        assert parse_camera_option(option, ErpCamera(128, 64)).camera.kind == "pinhole"
    with pytest.raises(CalibrationError, match="this is a folder; name the calibration file in it"):
        parse_camera_option(str(tmp_path), ErpCamera(128, 64))


def test_a_camera_of_a_chain_is_chosen_on_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "calib.yaml"
    rest = "camera_model: pinhole, distortion_model: none, resolution: [64, 48]"
    path.write_text("".join(f"cam{i}: {{{rest}, intrinsics: [{f}, 50, 32, 24]}}\n" for i, f in enumerate((50, 60))))
    choice = parse_camera_option(f"{path}#cam1", ErpCamera(128, 64))
    assert (choice.camera.to_dict()["fx"], choice.label) == (60, "calib-cam1")
    with pytest.warns(InputWarning, match="the cameras cam0, cam1: cam0 is taken; choose with calib.yaml#cam1"):
        assert parse_camera_option(str(path), ErpCamera(128, 64)).camera.to_dict()["fx"] == 50
    with pytest.raises(CalibrationError, match="did you mean 'cam1'"):
        read_calibration(f"{path}#cam2")

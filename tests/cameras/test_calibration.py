"""Calibration files: round trips, every variant of OCamCalib's, and bad input."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from camera_strategies import EXAMPLES, QUICK, STRATEGIES
from hypothesis import given, settings
from hypothesis import strategies as st

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
from panobench.errors import CalibrationError, InputWarning, PanobenchError, UnknownNameError, UnsupportedError

UP_POLY = [-244.5239, 0.0, 1.748610e-3, -1.757770e-6, 4.475965e-9]
UP_INVERSE = [376.845565, 246.746504, 19.035187, 23.840497, 18.991943, 6.066253, 1.560387, 5.854280]
UP_INVERSE += [3.458320, -1.995166, -1.509264, 1.089614, 1.340245, 0.255323]
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


def refusal(path: Path, format: str) -> str | None:
    """The message with which the file is refused, or None if it is read."""
    try:
        read_calibration(path, format)
    except PanobenchError as error:
        return str(error)
    return None


def ocamcalib_text(
    descending: bool = False,
    flipped: bool = False,
    theta_flipped: bool = False,
    swapped: bool = False,
    poly: list[float] = UP_POLY,
    affine: str = "1.0 0.0 0.0",
) -> str:
    poly = [-p for p in poly] if flipped else poly
    inverse = [q * (-1) ** i for i, q in enumerate(UP_INVERSE)] if theta_flipped else UP_INVERSE
    inverse = inverse[::-1] if descending else inverse
    centre = "645.107791 486.025172" if swapped else "486.025172 645.107791"
    lines = [f"5 {' '.join(map(repr, poly))} ", f"14 {' '.join(map(repr, inverse))}", centre, affine, "960 1280"]
    return "\n\n".join(f"# block {i}\n\n{line}" for i, line in enumerate(lines, 1)) + "\n"


@pytest.mark.parametrize(("descending", "flipped", "theta", "swapped"), list(itertools.product((0, 1), repeat=4)))
def test_ocamcalib_in_every_order_and_sign(
    tmp_path: Path, descending: int, flipped: int, theta: int, swapped: int
) -> None:
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text(bool(descending), bool(flipped), bool(theta), bool(swapped)))
    found = inspect_calibration(path)
    up = builtin_calibration("palvio_up")
    assert found.camera == up.with_mask(None)
    notes = " / ".join(found.notes)
    assert ("descending" in notes) == bool(descending)
    assert ("ascending" in notes) != bool(descending)
    assert ("positive constant term" in notes) == bool(flipped)
    assert ("sign of theta turned" in notes) == bool(theta)
    assert ("column, row" in notes) == bool(swapped)
    assert "agree to 0.0" in notes


def test_ocamcalib_native_axes(tmp_path: Path) -> None:
    """The native x axis runs along the rows: its affine matrix is that of (row, column)."""
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text(affine="1.01 0.02 -0.03"))
    camera = read_calibration(path)
    rho = 300.0
    z = -np.polynomial.polynomial.polyval(rho, UP_POLY)  # out of the lens
    for phi in (0.3, 1.2, 2.9, -2.0):
        x, y = rho * np.cos(phi), rho * np.sin(phi)  # native: x along rows, y along columns
        row, column = 1.01 * x + 0.02 * y + 486.025172, -0.03 * x + y + 645.107791
        pixel, valid = camera.project([y, x, z])
        assert valid
        assert pixel == pytest.approx([column + 0.5, row + 0.5], abs=1e-6)
    write_calibration(camera, tmp_path / "again.txt", "ocamcalib")
    again = [float(v) for v in (tmp_path / "again.txt").read_text().split("affine")[1].split("\n\n")[1].split()]
    assert again == pytest.approx([1.01, 0.02, -0.03])


def test_a_fisheye_of_the_wild(tmp_path: Path) -> None:
    """A 1440x1440 action camera, calibrated with OCamCalib 3; numbers published in its owner's notes."""
    path = tmp_path / "calib_results.txt"
    path.write_text(
        "5 -2.716972e+02 0.000000e+00 -2.741744e-06 1.840940e-06 -8.024838e-10\n"
        "13 583.439624 470.805865 97.165132 120.712689 100.686168 55.067847 67.348203 15.186683 1.492255 84.459767"
        " 105.607698 48.090642 7.785426\n728.648728 729.090632\n1.001407 -0.000818 0.000221\n1440 1440\n"
    )
    found = inspect_calibration(path)
    assert isinstance(found.camera, ScaramuzzaCamera)
    assert any("ascending" in note for note in found.notes)
    assert np.rad2deg(found.camera.polar_angle(583.44 * found.camera.c)) == pytest.approx(90, abs=0.3)


def test_disagreeing_polynomials_name_the_radius(tmp_path: Path) -> None:
    """PALVIO's downward camera as printed upstream, with the sign error of its third-order coefficient."""
    down = builtin_calibration("palvio_down")
    assert isinstance(down, ScaramuzzaCamera)
    write_calibration(down, tmp_path / "good.yaml", "lfvio")
    assert read_calibration(tmp_path / "good.yaml") == down.with_mask(None)
    text = (tmp_path / "good.yaml").read_text().replace("-9.486697e-07", "9.486697e-07")
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(
        CalibrationError, match=r"bad.yaml:\d+: .*disagree.* from r = 1[56]\d px .*inside the valid annulus"
    ):
        read_calibration(tmp_path / "bad.yaml")
    wrong = [*UP_POLY[:3], -UP_POLY[3], UP_POLY[4]]
    (tmp_path / "calib_results.txt").write_text(ocamcalib_text(poly=wrong))
    with pytest.raises(CalibrationError, match=r"calib_results.txt:7: .*r = \d+ px"):
        read_calibration(tmp_path / "calib_results.txt")
    values = {**down.to_dict(), "poly": [-239.1784, 0.0, 1.55204e-3, 9.486697e-7, 3.552717e-9]}
    import yaml

    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(CalibrationError, match="disagree"):
        read_calibration(tmp_path / "camera.yaml")


def test_the_annulus_decides(tmp_path: Path) -> None:
    """PALVIO's inverse is only fitted from about 105 px outward: fine unless the annulus reaches further in."""
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text())
    camera = read_calibration(path, annulus=(160, 500))
    assert isinstance(camera, ScaramuzzaCamera)
    assert (camera.r_min, camera.r_max) == (160, 500)
    with pytest.raises(CalibrationError, match=r"from r = 60 px .*inside the valid annulus 60\.\.500"):
        read_calibration(path, annulus=(60, 500))
    assert any("blind centre" in note and "105 px" in note for note in inspect_calibration(path).notes)


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
    path.write_text(LFVIO.format(inverse="\n".join(f"   p{i}: {q}" for i, q in enumerate([*UP_INVERSE, 0.0, 0.0]))))
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


def test_mask_beside_the_camera_file(tmp_path: Path) -> None:
    up = builtin_calibration("palvio_up").scaled(160)
    write_calibration(up, tmp_path / "camera.yaml")
    assert (tmp_path / "mask.png").is_file()
    assert read_calibration(tmp_path / "camera.yaml") == up
    (tmp_path / "mask.png").write_bytes(b"no image")
    with pytest.raises(CalibrationError, match=r"camera.yaml:\d+: the mask file mask.png is not an image"):
        read_calibration(tmp_path / "camera.yaml")
    (tmp_path / "mask.png").unlink()
    with pytest.raises(CalibrationError, match="missing"):
        read_calibration(tmp_path / "camera.yaml")
    text = (tmp_path / "camera.yaml").read_text()
    (tmp_path / "camera.yaml").write_text(text.replace("mask.png", "../mask.png"))
    with pytest.raises(CalibrationError, match="beside"):
        read_calibration(tmp_path / "camera.yaml")


def test_calibration_for_another_resolution(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    write_calibration(builtin_calibration("palvio_up"), path)
    assert read_calibration(path, size=(1280, 960)).width == 1280
    with pytest.raises(CalibrationError, match=r"is for 1280x960 images, these are 640x480; .*scale"):
        read_calibration(path, size=(640, 480))
    with pytest.raises(CalibrationError, match=r"is for 1280x960 images, these are 1280x720$"):
        read_calibration(path, size=(1280, 720))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: 1\nfy: 1\ncx: 5\n", "'cy' is missing"),
        ("model: erp\nwidth: wide\nheight: 10\n", r":2: .*width must be a whole number from 1 to 65536, not 'wide'"),
        ("model: erp\nwidth: 21\nheight: 10\n", "a panorama's width must be even, not 21"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: 1\nfy: one\ncx: 5\ncy: 5\n", "fy must be a number, not 'one'"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: -1\nfy: 1\ncx: 5\ncy: 5\n", "positive"),
        ("model: pinhole\nwidth: 10.5\nheight: 10\nfx: 1\nfy: 1\ncx: 5\ncy: 5\n", "width must be a whole number"),
        ("model: pinhol\nwidth: 10\n", "did you mean 'pinhole'"),
        ("model: erp\nwidth: 20\nwidth: 20\nheight: 10\n", r":3: 'width' is given twice"),
        ("model: erp\nwidth: 20\nheight: 10\nhfov: 10\n", r":4: .*unknown value 'hfov'"),
        ("model: erp\nwidth: &a 20\nheight: *a\n", "aliases are not allowed"),
        ("model: erp\nwidth: !!python/object/apply:os.system [ls]\n", "not valid YAML"),
        ("model: erp\n  width: 20\n", r":2: not valid YAML"),
        ("model: [" + "[" * 1500, "nested too deeply|not valid YAML"),
        ("5 -244 0 0.001\n", "five lines"),
        ("hello\n", "not recognised"),
        ("{width: 64, height: 32}\n", "not recognised"),
        ("{model: erp,\n width: wide, height: 10}\n", r":2: .*width must be a whole number"),
        ("{model: erp, width: 64\n", "not valid YAML"),
        ("{" * 1500, "nested too deeply|not valid YAML"),
    ],
)
def test_bad_files_are_explained(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / ("camera.txt" if text[:1] in "5h" else "camera.yaml")
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_calibration(path, "ocamcalib" if text.startswith("5") else None)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_text(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    with pytest.raises(CalibrationError, match="missing"):
        read_calibration(path)
    path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    with pytest.raises(CalibrationError, match=r"not a text file|not UTF-8 text"):
        read_calibration(path)
    path.write_bytes(b"a: 1\n" * 300_000)
    with pytest.raises(CalibrationError, match="over 1 MiB, too large for calibration file"):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="this is a folder"):
        read_calibration(tmp_path)
    with pytest.raises(UnknownNameError, match="did you mean 'kalibr'"):
        read_calibration(path, "calibr")
    with pytest.raises(UnknownNameError, match="palvio_up"):
        builtin_calibration("palvio")


@pytest.mark.parametrize("format", sorted(WRITTEN))
def test_damaged_files_never_crash(tmp_path: Path, format: str) -> None:
    """Cut, duplicated and altered characters give a camera or a CalibrationError, nothing else."""
    path = tmp_path / "x.yaml"
    model = "pal" if format in ("ocamcalib", "lfvio") else "fisheye"
    camera = builtin_calibration("palvio_up") if model == "pal" else EXAMPLES[model]
    write_calibration(camera, path, format)
    good = path.read_text()

    @settings(QUICK, max_examples=80)
    @given(
        st.integers(0, len(good)),
        st.integers(0, 30),
        st.one_of(st.text(max_size=4), st.sampled_from(["1e999", ".nan", "-", "[", "{", ": ", "\n", "\t", "!!map "])),
    )
    def check(start: int, length: int, insert: str) -> None:
        path.write_text(good[:start] + insert + good[start + length :], encoding="utf-8", errors="replace")
        message = refusal(path, format)
        assert message is None or (str(path) in message and "\n" not in message)

    check()

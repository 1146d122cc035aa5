"""LF-VISLAM's adapter against a stand-in for a ROS workspace whose nodes check the settings.

The genuine program runs, too, where a workspace with it is sourced.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_lf_vislam import SPEC
from panobench_lf_vislam.method import LfVislam, LfVislamConfig, ring_section

import panobench
from panobench import Camera, MethodError, Trajectory, UnsupportedError
from panobench.external import BAG_START_S, camodocal_camera, opencv_yaml
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.testing import (
    IDLE,
    TinySequence,
    annular_camera,
    assert_conforms,
    camera_from_dict,
    pose_rows,
    run_method,
    write_ros_workspace,
)

T_BODY_CAM = make_pose(so3_exp([-0.4, 0.2, 1.3]), [0.0, 0.0, 0.03])
PAL = annular_camera()

ESTIMATOR = """
import re
settings = open(parameters["config_file"]).read()
assert 'model_type: "scaramuzza"' in settings and "   p19: 0.0" in settings and "min_r: 16" in settings, settings
output = re.search(r'output_path: "([^"]+)"', settings)[1]
wait_for_end()
open(output + "/stamped_traj_estimate.txt", "w").write(%r)
time.sleep(600)
"""


@pytest.fixture(autouse=True)
def short_idle_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panobench.external.ros.IDLE_S", 1)


def body_rows(sequence: TinySequence) -> str:
    """As LF-VISLAM writes it: TUM rows of the body on the bag's clock."""
    assert sequence.groundtruth is not None
    body = Trajectory(sequence.times + BAG_START_S, sequence.groundtruth.T_wc @ invert_pose(T_BODY_CAM))
    return "".join(" ".join(f"{v:.12f}" for v in row) + "\n" for row in pose_rows(body))


def workspace(folder: Path, monkeypatch: pytest.MonkeyPatch, estimator: str) -> LfVislam:
    for key, value in write_ros_workspace(folder, {"feature_tracker": IDLE, "vins_estimator": estimator}).items():
        monkeypatch.setenv(key, value)
    return LfVislam(LfVislamConfig(command=str(folder / "bin" / "roslaunch")))


def masked_lens(hole: float, reach: float, centre: tuple[float, float]) -> Camera:
    """A lens of PALVIO's kind at half its size, whose valid ring is given by a mask and lies off the lens's centre."""
    values = {"model": "pal", "width": 640, "height": 480, "cx": 323.0, "cy": 243.5, "c": 1.0, "d": 0.0, "e": 0.0}
    values |= {"poly": [-122.3, 0.0, 3.5e-3, -7.0e-6, 3.6e-8], "inv_poly": [188.0, 123.0, 9.5, 12.0]}
    v, u = np.mgrid[:480, :640]
    distance = np.hypot(u - centre[0], v - centre[1])
    return camera_from_dict(values).with_mask((distance > hole) & (distance <= reach))


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_LF_VISLAM_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_annular_images_and_samples_go_in_and_camera_poses_come_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = TinySequence(PAL, n=5, T_body_cam=T_BODY_CAM)
    method = workspace(tmp_path / "ws", monkeypatch, ESTIMATOR % body_rows(sequence))
    estimate = run_method(method, sequence, needs=SPEC.needs).estimate
    assert np.allclose(estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-7)  # type: ignore[union-attr]
    assert estimate.metric


def test_an_estimator_that_never_started_is_an_error_with_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = "# stamped_traj_estimate.txt\nprint('Not enough features or parallax', flush=True)\ntime.sleep(600)"
    with pytest.raises(MethodError, match=r"wrote no such file; the log ends: Not enough features"):
        run_method(
            workspace(tmp_path / "ws", monkeypatch, lost),
            TinySequence(PAL, n=3, T_body_cam=T_BODY_CAM),
            needs=SPEC.needs,
        )


def test_other_cameras_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnsupportedError, match="takes panoramic annular images, not erp"):
        run_method(
            workspace(tmp_path / "ws", monkeypatch, ESTIMATOR),
            TinySequence(n=2, T_body_cam=T_BODY_CAM),
            needs=SPEC.needs,
        )
    with pytest.raises(UnsupportedError, match="5 direct"):
        camodocal_camera(dataclasses.replace(PAL, poly=(-24.0, 0.0, 0.01)), "LF-VISLAM")  # type: ignore[type-var]


def test_the_camera_is_written_in_ocamcalibs_numbers(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(opencv_yaml(camodocal_camera(PAL, "LF-VISLAM")))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert file.getNode("poly_parameters").getNode("p4").real() == 0.00004475965
    assert file.getNode("affine_parameters").getNode("cx").real() == 64.0
    assert file.getNode("inv_poly_parameters").getNode("p1").real() == 24.7


def test_a_ring_given_as_a_mask_becomes_two_circles(tmp_path: Path) -> None:
    """PALVIO's calibration has no radii but a mask, about another centre than the lens's, and the image cuts it off."""
    values = ring_section(masked_lens(80, 250, (321.0, 246.0)), tmp_path)
    assert values == {"center_x": 321.0, "center_y": 246.0, "max_r": 250, "min_r": 80}
    assert ring_section(PAL, tmp_path) == {"center_x": 64.0, "center_y": 48.0, "max_r": 47, "min_r": 16}


def test_a_mask_that_is_no_ring_is_used_itself(tmp_path: Path) -> None:
    lens = masked_lens(80, 250, (321.0, 246.0))
    valid = lens.valid_mask().copy()
    valid[330:, 250:400] = False  # an operator
    values = ring_section(lens.with_mask(valid), tmp_path)
    assert values["fisheye"] == 1
    mask = cv2.imread(str(tmp_path / "config" / "fisheye_mask.jpg"), cv2.IMREAD_GRAYSCALE)
    assert np.array_equal(mask == 255, valid)


def test_the_settings_are_those_published_for_palvio(tmp_path: Path) -> None:
    imu = TinySequence(PAL, n=8, T_body_cam=T_BODY_CAM).imu
    assert imu is not None
    values = LfVislam().settings(PAL, imu, tmp_path, tmp_path)
    expected = {"freq": 10, "estimate_extrinsic": 1, "max_cnt": 200, "min_dist": 20, "acc_w": 0.04, "gyr_w": 0.002}
    assert {key: values[key] for key in expected} == expected


@pytest.mark.skipif(LfVislam.missing() is not None, reason="no workspace with LF-VISLAM is sourced")
def test_the_genuine_lf_vislam_follows_a_smooth_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()  # it takes longer than a second to work off its buffer
    bag = ["--out", str(tmp_path / "path.bag"), "--frames", "120", "--source-width", "512", "--quiet"]
    subprocess.run([sys.executable, "-m", "panobench", "synth", "palvio", *bag], check=True)
    where = {"dataset": "palvio", "sequence": "path", "root": str(tmp_path), "camera": "pal", "width": 1280}
    run = panobench.run(tmp_path / "run", method="lf-vislam", settings={"rate": 0.3, "timeout_s": 180}, **where)
    assert run.metrics["tracked"] > 0.5
    assert run.metrics["ate_rmse_m"] < 0.3

"""LF-VISLAM's adapter against a stand-in for roslaunch that checks the launch file, the settings and the bag."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_lf_vislam import SPEC
from panobench_lf_vislam.method import LfVislam, LfVislamConfig, camera_section

from panobench import Imu, MethodError, Trajectory, UnsupportedError
from panobench.external import BAG_START_S, opencv_yaml
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.testing import TinySequence, annular_camera, assert_conforms, pose_rows, run_method, write_program

T_BODY_CAM = make_pose(so3_exp([-0.4, 0.2, 1.3]), [0.0, 0.0, 0.03])
#: A lens of PALVIO's kind at a tenth of its size: rho = 24.5 (1.54 - theta) nearly, 40 to 110 degrees.
PAL = annular_camera()

ROSLAUNCH = """
import re, sys
launch = open(sys.argv[1]).read()
settings = open(re.search(r'name="config_file" type="string" value="([^"]+)"', launch)[1]).read()
assert 'model_type: "scaramuzza"' in settings and "   p19: 0.0" in settings and "min_r: 16" in settings, settings
assert open(re.search(r'--rate=1 (\\S+?)"', launch)[1], "rb").read(13) == b"#ROSBAG V2.0\\n"
output = re.search(r'output_path: "([^"]+)"', settings)[1]
open(output + "/vins_result_no_loop.csv", "w").write(%r)
"""


class WithBody(TinySequence):
    @property
    def imu(self) -> Imu | None:
        imu = super().imu
        assert imu is not None
        return dataclasses.replace(imu, T_body_cam=T_BODY_CAM)


def body_rows(sequence: TinySequence) -> str:
    """As LF-VISLAM writes it: TUM rows of the body on the bag's clock."""
    assert sequence.groundtruth is not None
    body = Trajectory(sequence.times + BAG_START_S, sequence.groundtruth.T_wc @ invert_pose(T_BODY_CAM))
    return "".join(" ".join(f"{v:.12f}" for v in row) + "\n" for row in pose_rows(body))


def test_it_keeps_the_contract() -> None:
    assert_conforms(SPEC)


def test_annular_images_and_samples_go_in_and_camera_poses_come_out(tmp_path: Path) -> None:
    sequence = WithBody(PAL, n=5)
    path = write_program(tmp_path / "roslaunch", ROSLAUNCH % body_rows(sequence))
    estimate = run_method(LfVislam(LfVislamConfig(command=str(path))), sequence, needs=SPEC.needs).estimate
    assert np.allclose(estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-7)  # type: ignore[union-attr]
    assert estimate.metric


def test_an_estimator_that_never_started_is_an_error_with_the_log(tmp_path: Path) -> None:
    path = write_program(tmp_path / "roslaunch", "print('Not enough features or parallax')")
    with pytest.raises(MethodError, match=r"wrote no such file; the log ends: Not enough features"):
        run_method(LfVislam(LfVislamConfig(command=str(path))), WithBody(PAL, n=3), needs=SPEC.needs)


def test_other_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="takes panoramic annular images, not erp"):
        run_method(LfVislam(LfVislamConfig(command="true")), WithBody(n=2), needs=SPEC.needs)
    with pytest.raises(UnsupportedError, match="5 direct"):
        camera_section(dataclasses.replace(PAL, poly=(-24.0, 0.0, 0.01)))


def test_the_camera_is_written_in_ocamcalibs_numbers(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(opencv_yaml(camera_section(PAL)))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert file.getNode("poly_parameters").getNode("p4").real() == 0.00004475965
    assert file.getNode("affine_parameters").getNode("cx").real() == 64.0
    assert file.getNode("inv_poly_parameters").getNode("p1").real() == 24.7

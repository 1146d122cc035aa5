"""VINS-Mono's adapter against a stand-in for roslaunch that reads the launch file, the settings and the bag."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_vins_mono import SPEC
from panobench_vins_mono.method import VinsMono, VinsMonoConfig, camera_section, launch_file

from panobench import Imu, MethodError, Trajectory, UnsupportedError
from panobench.external import BAG_START_S, opencv_yaml, write_bag
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.testing import (
    TinySequence,
    assert_conforms,
    ate_rmse,
    camera_from_dict,
    pinhole_camera,
    pose_rows,
    run_method,
    write_program,
)

T_BODY_CAM = make_pose(so3_exp([0.1, 1.2, -0.3]), [0.05, -0.02, 0.1])
CAMERA = pinhole_camera(64, 90, 70)

ROSLAUNCH = """
import re, sys
launch = open(sys.argv[1]).read()
config = re.search(r'name="config_file" type="string" value="([^"]+)"', launch)[1]
bag = re.search(r'--rate=1 (\\S+?)"', launch)[1]
settings = open(config).read()
assert settings.startswith("%%YAML:1.0") and "model_type: \\"PINHOLE\\"" in settings
assert open(bag, "rb").read(13) == b"#ROSBAG V2.0\\n"
output = re.search(r'output_path: "([^"]+)"', settings)[1]
open(output + "/vins_result_no_loop.csv", "w").write(%r)
"""


class WithBody(TinySequence):
    """Inertial samples of a body that is not the camera (only the frames of reference matter here)."""

    @property
    def imu(self) -> Imu | None:
        imu = super().imu
        assert imu is not None
        return dataclasses.replace(imu, T_body_cam=T_BODY_CAM)


def body_csv(sequence: TinySequence) -> str:
    """As VINS-Mono writes it: nanoseconds on the bag's clock, body poses, qw first, velocities, a trailing comma."""
    assert sequence.groundtruth is not None
    body = Trajectory(sequence.times, sequence.groundtruth.T_wc @ invert_pose(T_BODY_CAM))
    lines = []
    for t, *rest in pose_rows(body, "wxyz"):
        lines.append(f"{(t + BAG_START_S) * 1e9:.0f}," + ",".join(f"{v:.9f}" for v in rest) + ",0.1,0.2,0.3,")
    return "\n".join(lines) + "\n"


def test_it_keeps_the_contract() -> None:
    assert_conforms(SPEC)


def test_camera_poses_come_back_from_body_poses(tmp_path: Path) -> None:
    sequence = WithBody(CAMERA, n=6)
    path = write_program(tmp_path / "roslaunch", ROSLAUNCH % body_csv(sequence))
    run = run_method(VinsMono(VinsMonoConfig(command=str(path))), sequence, needs=SPEC.needs)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert np.allclose(run.estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-7)  # type: ignore[union-attr]
    assert run.estimate.metric
    assert ate_rmse(run, sequence) < 1e-7


def test_a_partial_csv_is_an_error_with_the_log(tmp_path: Path) -> None:
    sequence = WithBody(CAMERA, n=4)
    cut = body_csv(sequence)[:-60]
    path = write_program(tmp_path / "roslaunch", f"print('[player-2] process has finished cleanly')\n{ROSLAUNCH % cut}")
    with pytest.raises(MethodError, match=r"vins_result_no_loop\.csv:4: .*the log ends: \[player-2\]"):
        run_method(VinsMono(VinsMonoConfig(command=str(path))), sequence, needs=SPEC.needs)


def test_without_an_imu_it_is_unsupported() -> None:
    with pytest.raises(UnsupportedError, match="needs inertial samples"):
        run_method(VinsMono(VinsMonoConfig(command="true")), TinySequence(CAMERA, n=2))


def test_the_bag_holds_what_went_in(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    sequence = TinySequence(CAMERA, n=4)
    imu = sequence.imu
    assert imu is not None
    offset = write_bag(tmp_path / "x.bag", sequence, imu, "/cam", "/imu")
    store = get_typestore(Stores.ROS1_NOETIC)
    seen: dict[str, list] = {"/cam": [], "/imu": []}
    with Reader(tmp_path / "x.bag") as reader:
        for connection, stamp, raw in reader.messages():
            seen[connection.topic].append((stamp * 1e-9 + offset, store.deserialize_ros1(raw, connection.msgtype)))
    assert np.allclose([t for t, _ in seen["/cam"]], sequence.times, atol=1e-8)
    assert len(seen["/imu"]) == len(imu.times)
    gyro = [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for _, m in seen["/imu"]]
    assert np.allclose(gyro, imu.gyro)
    image = seen["/cam"][2][1]
    assert np.array_equal(
        image.data.reshape(image.height, image.width), cv2.cvtColor(sequence.image(2), cv2.COLOR_RGB2GRAY)
    )


def test_settings_are_read_back_by_opencv(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(opencv_yaml({**camera_section(CAMERA), "extrinsicRotation": T_BODY_CAM[:3, :3]}))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert np.allclose(file.getNode("extrinsicRotation").mat(), T_BODY_CAM[:3, :3])
    assert file.getNode("projection_parameters").getNode("cx").real() == CAMERA.cx - 0.5


def test_meis_model_is_known() -> None:
    section = camera_section(
        camera_from_dict(
            {"model": "omni", "width": 64, "height": 64, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 32.0, "xi": 1.2}
        )
    )
    assert section["model_type"] == "MEI"
    assert section["mirror_parameters"] == {"xi": 1.2}


def test_the_launch_file_is_xml_that_ends_with_the_recording() -> None:
    root = ElementTree.fromstring(launch_file("/w/c.yaml", "/w/r.bag", 1.0, loop=True))
    assert [n.get("type") for n in root] == ["feature_tracker", "vins_estimator", "pose_graph", "play"]
    assert root[-1].get("required") == "true"
    with pytest.raises(UnsupportedError):
        launch_file('/w/"><evil/>.yaml', "/w/r.bag", 1.0, loop=False)

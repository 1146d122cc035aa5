"""VINS-Mono's adapter against a stand-in for a ROS workspace, whose nodes read the settings and lag behind the bag.

The genuine program runs, too, where a workspace with it is sourced.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_vins_mono import SPEC
from panobench_vins_mono.method import VinsMono, VinsMonoConfig

import panobench
from panobench import Camera, Imu, MethodError, Trajectory, UnavailableError, UnsupportedError
from panobench.external import BAG_START_S, camodocal_camera, opencv_yaml, write_bag
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.testing import (
    IDLE,
    TinySequence,
    annular_camera,
    assert_conforms,
    ate_rmse,
    camera_from_dict,
    pinhole_camera,
    pose_rows,
    run_method,
    write_ros_workspace,
)

T_BODY_CAM = make_pose(so3_exp([0.1, 1.2, -0.3]), [0.05, -0.02, 0.1])
CAMERA = pinhole_camera(64, 90, 70)

#: Goes on writing after the recording has ended, a row at a time, and never ends by itself.
ESTIMATOR = """
import re
settings = open(parameters["config_file"]).read()
assert settings.startswith("%%YAML:1.0") and "freq: 10" in settings and "td: 0.0" in settings
assert parameters["vins_folder"].endswith("/")
output = re.search(r'output_path: "([^"]+)"', settings)[1]
open(output + "/vins_result_no_loop.csv", "w").close()
wait_for_end()
for row in %r:
    time.sleep(0.3)
    with open(output + "/vins_result_no_loop.csv", "a") as file:
        file.write(row)
time.sleep(600)
"""


@pytest.fixture(autouse=True)
def short_idle_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panobench.external.ros.IDLE_S", 1)


def csv_rows(sequence: TinySequence) -> list[str]:
    """As VINS-Mono writes them: nanoseconds on the bag's clock, body poses, qw first, velocities, a trailing comma."""
    assert sequence.groundtruth is not None
    body = Trajectory(sequence.times, sequence.groundtruth.T_wc @ invert_pose(T_BODY_CAM))
    return [
        f"{(t + BAG_START_S) * 1e9:.0f}," + ",".join(f"{v:.9f}" for v in rest) + ",0.1,0.2,0.3,\n"
        for t, *rest in pose_rows(body, "wxyz")
    ]


def workspace(
    folder: Path, monkeypatch: pytest.MonkeyPatch, estimator: str, tracker: str = IDLE, **options: object
) -> VinsMono:
    """The method with a sourced stand-in workspace, whatever ROS the machine has."""
    for key, value in write_ros_workspace(folder, {"feature_tracker": tracker, "vins_estimator": estimator}).items():
        monkeypatch.setenv(key, value)
    monkeypatch.setenv("ROS_MASTER_URI", "http://elsewhere:11311")
    return VinsMono(VinsMonoConfig(command=str(folder / "bin" / "roslaunch"), **options))  # type: ignore[arg-type]


def settings(camera: Camera, folder: Path, **options: object) -> dict:
    imu = TinySequence(CAMERA, n=8, T_body_cam=T_BODY_CAM).imu
    assert imu is not None
    return VinsMono(VinsMonoConfig(**options)).settings(camera, imu, folder, folder / "out")  # type: ignore[arg-type]


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_VINS_MONO_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_camera_poses_come_back_from_body_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = TinySequence(CAMERA, n=6, T_body_cam=T_BODY_CAM)
    method = workspace(tmp_path / "ws", monkeypatch, ESTIMATOR % csv_rows(sequence))
    assert method.missing(method.config) is None
    run = run_method(method, sequence, needs=SPEC.needs)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert np.allclose(run.estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-7)  # type: ignore[union-attr]
    assert run.estimate.metric
    assert ate_rmse(run, sequence) < 1e-7


def test_frames_between_two_answers_are_interpolated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimator answers every other frame of a camera that is faster than it."""
    sequence = TinySequence(CAMERA, n=7, rate=20.0, T_body_cam=T_BODY_CAM)
    method = workspace(tmp_path / "ws", monkeypatch, ESTIMATOR % csv_rows(sequence)[::2])
    estimate = run_method(method, sequence, needs=SPEC.needs).estimate
    assert np.array_equal(estimate.trajectory.times, sequence.times)
    assert estimate.extra["interpolated_frames"] == 3
    assert sorted(estimate.frames) == [1, 3, 5]
    error = estimate.trajectory.positions - sequence.groundtruth.positions  # type: ignore[union-attr]
    assert np.abs(error[::2]).max() < 1e-7
    assert np.abs(error).max() < 0.02


def test_a_partial_csv_is_an_error_with_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = TinySequence(CAMERA, n=4, T_body_cam=T_BODY_CAM)
    rows = csv_rows(sequence)
    rows[-1] = rows[-1][:-60]
    method = workspace(tmp_path / "ws", monkeypatch, f"print('Not enough features', flush=True)\n{ESTIMATOR % rows}")
    with pytest.raises(MethodError, match=r"vins_result_no_loop\.csv:4: .*the log ends: Not enough features"):
        run_method(method, sequence, needs=SPEC.needs)


def test_a_node_that_crashes_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recording would take 600 seconds."""
    method = workspace(tmp_path / "ws", monkeypatch, "# vins_result_no_loop.csv\nsys.exit('Segmentation fault')")
    (tmp_path / "ws" / "lib" / "rosbag" / "play").write_text("#!/bin/sh\nsleep 600\n")
    with pytest.raises(MethodError, match=r"wrote no such file; the log ends: Segmentation fault"):
        run_method(method, TinySequence(CAMERA, n=3, T_body_cam=T_BODY_CAM), needs=SPEC.needs)


def test_the_log_says_why_it_never_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = "print('Not enough features or parallax; Move device around', flush=True)\n"
    method = workspace(tmp_path / "ws", monkeypatch, 2 * words + ESTIMATOR % [])
    run = run_method(method, TinySequence(CAMERA, n=3, T_body_cam=T_BODY_CAM), needs=SPEC.needs)
    assert not len(run.estimate.trajectory)
    assert run.log[-1] == "VINS-Mono never started: 'Not enough features or parallax' (2 times)"


def test_roslaunch_alone_cannot_run_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = workspace(tmp_path / "ws", monkeypatch, ESTIMATOR)
    monkeypatch.setenv("CMAKE_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("PANOBENCH_VINS_MONO_COMMAND", method.config.command)
    with pytest.raises(UnavailableError, match=r"no package 'feature_tracker' .*; source devel/setup\.bash"):
        run_method(method, TinySequence(CAMERA, n=2, T_body_cam=T_BODY_CAM), needs=SPEC.needs)
    assert [f.detail for f in VinsMono.diagnose() if not f.ok] == [
        "no package 'feature_tracker' in CMAKE_PREFIX_PATH",
        "no package 'vins_estimator' in CMAKE_PREFIX_PATH",
    ]


def test_the_workspace_of_a_descendant_is_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LF-VISLAM's packages have the same names."""
    method = workspace(tmp_path / "ws", monkeypatch, "# stamped_traj_estimate.txt")
    assert "do not write VINS-Mono's 'vins_result_no_loop.csv'" in str(VinsMono.missing(method.config))


def test_without_an_imu_it_is_unsupported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnsupportedError, match="needs inertial samples"):
        run_method(workspace(tmp_path / "ws", monkeypatch, ESTIMATOR), TinySequence(CAMERA, n=2))


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
    (tmp_path / "s.yaml").write_text(opencv_yaml(settings(CAMERA, tmp_path)))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert np.allclose(file.getNode("extrinsicRotation").mat(), T_BODY_CAM[:3, :3])
    assert file.getNode("projection_parameters").getNode("cx").real() == CAMERA.to_dict()["cx"] - 0.5
    assert file.getNode("fisheye").real() == 0
    assert not (tmp_path / "config").exists()


def test_noise_and_gravity_are_the_sequences(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(2000) / 200.0
    motion = np.stack([np.sin(3 * t), np.cos(2 * t), 0.2 * t], axis=1)
    imu = Imu(t, motion + rng.normal(0, 0.002, (2000, 3)), 9.8 + motion + rng.normal(0, 0.02, (2000, 3)), gravity=9.79)
    values = VinsMono().settings(CAMERA, imu, tmp_path, tmp_path)
    assert values["gyr_n"] == pytest.approx(0.002, rel=0.05)
    assert values["acc_n"] == pytest.approx(0.02, rel=0.05)
    assert values["g_norm"] == 9.79
    chosen = VinsMono(VinsMonoConfig(acc_n=0.1, g_norm=9.81)).settings(CAMERA, imu, tmp_path, tmp_path)
    assert (chosen["acc_n"], chosen["g_norm"]) == (0.1, 9.81)
    still = Imu(t, np.zeros((2000, 3)), np.tile([0.0, 0.0, 9.8], (2000, 1)))
    assert VinsMono().settings(CAMERA, still, tmp_path, tmp_path)["gyr_n"] > 0


def test_annular_images_have_their_model_and_a_mask(tmp_path: Path) -> None:
    lens = annular_camera()
    values = settings(lens, tmp_path)
    assert values["model_type"] == "scaramuzza"
    assert values["inv_poly_parameters"]["p19"] == 0.0
    assert values["fisheye"] == 1
    mask = cv2.imread(str(tmp_path / "config" / "fisheye_mask.jpg"), cv2.IMREAD_GRAYSCALE)
    assert set(np.unique(mask)) == {0, 255}
    assert mask[~lens.valid_mask()].max() == 0
    beyond = np.nan_to_num(lens.rays()[..., 2]) < np.cos(np.deg2rad(86))
    assert mask[beyond].max() == 0  # its points lie on the plane z = 1
    assert mask.mean() > 20


def test_meis_model_is_known() -> None:
    values = {"model": "omni", "width": 64, "height": 64, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 32.0, "xi": 1.2}
    section = camodocal_camera(camera_from_dict(values), "VINS-Mono")
    assert section["model_type"] == "MEI"
    assert section["mirror_parameters"] == {"xi": 1.2}


def test_the_pose_graph_is_started_for_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = VinsMono(VinsMonoConfig(loop=True))
    assert method.packages()[-1] == "pose_graph"
    assert method.node_parameters("pose_graph")["skip_dis"] == 0.0
    assert method.result() == ("vins_result_loop.csv", "euroc")
    assert settings(CAMERA, tmp_path, loop=True)["loop_closure"] == 1


@pytest.mark.skipif(VinsMono.missing() is not None, reason="no workspace with VINS-Mono is sourced")
def test_the_genuine_vins_mono_follows_a_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()  # it takes longer than a second to work off its buffer
    lens = ["--camera", "pinhole", "--fov", "90x65", "--width", "480", "--source-width", "512"]
    walk = ["--seconds", "12", "--speed", "1.4", "--turn", "250", "--gait", "1.5", "--seed", "3"]
    bag = ["--out", str(tmp_path / "walk.bag"), "--quiet"]
    subprocess.run([sys.executable, "-m", "panobench", "synth", "palvio", *bag, *lens, *walk], check=True)
    where = {"dataset": "palvio", "sequence": "walk", "root": str(tmp_path), "camera": "pinhole", "width": 480}
    run = panobench.run(tmp_path / "run", method="vins-mono", settings={"timeout_s": 120}, **where)
    assert run.metrics["tracked"] > 0.5
    assert run.metrics["ate_rmse_m"] < 0.2

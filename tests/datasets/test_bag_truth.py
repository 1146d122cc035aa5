"""What a bag says of the camera and of its true poses."""

from __future__ import annotations

from pathlib import Path

import bag_samples as samples
import numpy as np
import pytest
from bag_samples import FRAMES, SIZE, START, Recording, opened, usual, write
from dataset_samples import poses

from panobench.errors import CalibrationError, DatasetError
from panobench.geometry import invert_pose, make_pose, so3_exp


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "PoseWithCovarianceStamped", "Odometry"])
def test_kinds_of_true_poses(tmp_path: Path, kind: str) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        samples.truth(recording, "/vicon/head", kind)

    sequence = opened(write(tmp_path / "walk", fill, "db3"))
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-9)
    assert any(
        line.startswith("true poses are from /vicon/head, taken for the camera's") for line in sequence.remarks()
    )


def test_odometry_is_not_the_truth_unless_somebody_says_so(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        samples.truth(recording, "/odom", "Odometry")

    path = write(tmp_path / "walk", fill)
    sequence = opened(path)
    assert sequence.groundtruth is None
    assert "poses on /odom are not taken for the truth; --groundtruth-topic chooses some" in sequence.remarks()
    chosen = opened(path, groundtruth_topic="odom")
    assert chosen.groundtruth is not None
    assert opened(write(tmp_path / "other", usual), groundtruth_topic="none").groundtruth is None


LEVER = make_pose(so3_exp(np.array([0.3, -0.2, 1.0])), np.array([0.1, 0.2, -0.3]))


def test_poses_of_a_body_are_moved_to_the_camera(tmp_path: Path) -> None:
    """By /tf_static: body -> mast -> cam; also for the inertial samples."""
    mast = make_pose(so3_exp(np.array([0.0, 0.4, 0.0])), np.array([0.0, 0.0, 1.0]))

    def fill(recording: Recording) -> None:
        samples.images(recording)
        make = recording.messages
        recording.add("/tf_static", make.static("mast", "cam", invert_pose(mast) @ LEVER))
        recording.add("/tf_static", make.static("body", "mast", mast))
        recording.add("/tf_static", make.static("imu", "body", invert_pose(mast)))
        for t, T in zip(samples.times(), poses(FRAMES)):
            recording.add("/gt", make.pose("Odometry", t, T @ invert_pose(LEVER)))
            recording.add("/imu", make.imu(t, (0, 0, 0), (0, 0, 9.8)))

    for kind in ("ros1", "mcap"):
        sequence = opened(write(tmp_path / kind, fill, kind))
        assert sequence.groundtruth is not None
        np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-9)
        assert sequence.imu is not None
        np.testing.assert_allclose(sequence.imu.T_body_cam, invert_pose(mast) @ LEVER, atol=1e-9)
        assert any("those of 'body', moved to the camera by /tf_static" in line for line in sequence.remarks())


def test_extrinsics_and_clock_of_a_calibration(tmp_path: Path) -> None:
    T = "\n".join(f"  - {row.tolist()}" for row in invert_pose(LEVER))
    (tmp_path / "chain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n  intrinsics: [30, 30, 32, 16]\n"
        f"  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [64, 32]\n  T_cam_imu:\n{T}\n  timeshift_cam_imu: 0.25\n"
    )

    def fill(recording: Recording) -> None:
        samples.images(recording)
        for t, T in zip(samples.times(), poses(FRAMES)):
            recording.add("/gt", recording.messages.pose("PoseStamped", t, T @ invert_pose(LEVER)))
            recording.add("/imu", recording.messages.imu(t + 0.25, (0, 0, 0), (0, 0, 9.8)))

    sequence = opened(write(tmp_path / "walk", fill), calibration=f"{tmp_path / 'chain.yaml'}#cam0")
    assert sequence.camera.kind == "fisheye"
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-6)
    assert sequence.imu is not None
    np.testing.assert_allclose(sequence.imu.times, sequence.times, atol=1e-6)
    np.testing.assert_allclose(sequence.imu.T_body_cam, LEVER, atol=1e-6)


@pytest.mark.parametrize("kind", ["ros1", "db3"])
@pytest.mark.parametrize(
    ("topic", "model", "D", "camera"),
    [
        ("/cam/image_raw", "equidistant", [0.01, 0.0, 0.0, 0.0], "fisheye"),
        ("/cam/image_raw", "plumb_bob", [-0.1, 0.01, 0.0, 0.0, 0.0], "pinhole"),
        ("/cam/image_rect", "plumb_bob", [-0.1, 0.01, 0.0, 0.0, 0.0], "pinhole"),
    ],
)
def test_the_camera_from_camera_info(
    tmp_path: Path, kind: str, topic: str, model: str, D: list[float], camera: str
) -> None:
    K = [30.0, 0.0, 31.5, 0.0, 30.0, 15.5, 0.0, 0.0, 1.0]

    def fill(recording: Recording) -> None:
        samples.images(recording, topic)
        info = recording.messages.camera_info(SIZE, K, D, model)
        info.roi.width, info.roi.height = SIZE
        recording.add("/cam/camera_info", info, received=START)
        other = recording.messages.camera_info((99, 99), K, D, model)
        recording.add("/cam2/camera_info", other, received=START)

    sequence = opened(write(tmp_path / "walk", fill, kind))
    assert sequence.camera.kind == camera
    centre, _ = sequence.camera.project(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(centre, [32, 16])
    assert "the camera is from /cam/camera_info" in sequence.remarks()
    edge, _ = sequence.camera.project(np.array([0.5, 0.0, 1.0]))
    assert (edge[0] == pytest.approx(47)) == topic.endswith("rect")


def test_an_uncalibrated_camera_info_says_nothing(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        recording.add("/cam/camera_info", recording.messages.camera_info(SIZE, [0.0] * 9, [], ""), received=START)

    assert opened(write(tmp_path / "walk", fill)).camera.kind == "erp"


def test_a_lens_nobody_describes(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for t in samples.times(2):
            recording.add("/cam", recording.messages.image(t, np.zeros((48, 64), np.uint8), "mono8"))

    path = write(tmp_path / "walk", fill)
    with pytest.raises(DatasetError, match=r"64x48 pixels.*If a lens took it, say which: --calibration FILE"):
        opened(path)
    (tmp_path / "camera.yaml").write_text("model: pinhole\nwidth: 99\nheight: 48\nfx: 9\nfy: 9\ncx: 9\ncy: 9\n")
    with pytest.raises(CalibrationError, match="the calibration is for 99x48 images, these are 64x48"):
        opened(path)

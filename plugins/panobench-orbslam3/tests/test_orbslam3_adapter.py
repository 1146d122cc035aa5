"""ORB-SLAM3's adapters: the genuine system where pyorbslam3 is installed, stand-ins for both ways elsewhere."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_orbslam3 import BINARY, INERTIAL, PYTHON
from panobench_orbslam3.binary import OrbSlam3Binary
from panobench_orbslam3.bindings import OrbSlam3, OrbSlam3Config, OrbSlam3Inertial, OrbSlam3InertialConfig
from panobench_orbslam3.track import decode_grey_png

from panobench import Camera, Imu, MethodContext, MethodError, Trajectory, UnavailableError, UnsupportedError
from panobench.external import VOCABULARY_VARIABLE, OrbSlamConfig, opencv_yaml, orb_descriptors, train_vocabulary
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.testing import (
    TinySequence,
    assert_conforms,
    ate_rmse,
    camera_from_dict,
    fisheye_camera,
    pinhole_camera,
    pose_rows,
    run_method,
    write_program,
)

PINHOLE = pinhole_camera(96, 90, 70)


T_BODY_CAM = make_pose(so3_exp([0.1, 1.2, -0.3]), [0.05, -0.02, 0.1])


@pytest.fixture
def vocabulary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "ORBvoc.txt"
    path.write_text("10 6 0 0\n0 1 " + "0 " * 32 + "0.5\n")
    monkeypatch.setenv(VOCABULARY_VARIABLE, str(path))
    return path


@pytest.fixture
def sequence() -> TinySequence:
    return TinySequence(PINHOLE, n=6)


def saved(sequence: TinySequence) -> str:
    """As ORB-SLAM3 saves it: nanoseconds, the frame that started the map twice."""
    assert sequence.groundtruth is not None
    lines = [f"{t * 1e9:.6f} " + " ".join(f"{v:.9f}" for v in rest) for t, *rest in pose_rows(sequence.groundtruth)]
    return "\n".join([lines[0], *lines]) + "\n"


MONO_EUROC = """
import os, sys
vocabulary, settings, folder, times, name = sys.argv[1:]
assert open(vocabulary).readline().split() == ["10", "6", "0", "0"]
text = open(settings).read()
assert text.startswith("%%YAML:1.0") and 'Camera.type: "PinHole"' in text
for stamp in open(times).read().split():
    data = open(f"{folder}/mav0/cam0/data/{stamp}.png", "rb").read()
    assert data[:4] == b"\\x89PNG" and data[25] == 0, "a grey PNG"
open(f"f_{name}.txt", "w").write(%r)
open(f"kf_{name}.txt", "w").write(%r)
"""


def test_the_binary_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_ORBSLAM3_BINARY_RUN_IN", "venv:/no/such/place")
    assert_conforms(BINARY)


def test_the_bindings_keep_the_contract_where_they_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_ORBSLAM3_RUN_IN", "venv:/no/such/place")
    assert_conforms(PYTHON)
    assert_conforms(INERTIAL)


def test_the_binary_gets_its_files_and_its_answer_is_read(
    sequence: TinySequence, vocabulary: Path, tmp_path: Path
) -> None:
    rows = saved(sequence)
    keys = "\n".join(rows.splitlines()[1:3]) + "\n"
    program = write_program(tmp_path / "mono_euroc", MONO_EUROC % (rows, keys))
    estimate = run_method(OrbSlam3Binary(OrbSlamConfig(command=str(program), levels=2)), sequence).estimate
    assert len(estimate.trajectory) == 6
    assert np.allclose(estimate.trajectory.positions, sequence.groundtruth.positions, atol=1e-8)  # type: ignore[union-attr]
    assert estimate.keyframes == [0, 1]


def test_a_crash_of_the_binary_shows_its_log(sequence: TinySequence, vocabulary: Path, tmp_path: Path) -> None:
    program = write_program(tmp_path / "mono_euroc", "import sys; print('Wrong path to vocabulary'); sys.exit(255)")
    with pytest.raises(MethodError, match=r"exit code 255; the log ends: Wrong path to vocabulary"):
        run_method(OrbSlam3Binary(OrbSlamConfig(command=str(program), levels=2)), sequence)


def test_a_missing_binary_is_unavailable(sequence: TinySequence, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_ORBSLAM3_BINARY_COMMAND", "no-such-program")
    with pytest.raises(UnavailableError, match="PANOBENCH_ORBSLAM3_BINARY_COMMAND"):
        run_method(OrbSlam3Binary(), sequence)


FAKE_PACKAGE = """
class Sensor:
    MONOCULAR, IMU_MONOCULAR = "mono", "imu"

class Result:
    state, pose_valid = "OK", True

class Slam:
    def __init__(self, vocabulary, settings, sensor, use_viewer=False):
        assert open(vocabulary).readline() and not use_viewer
        assert (sensor == "imu") == ("IMU.T_b_c1: !!opencv-matrix" in open(settings).read())
        self.sensor, self.times = sensor, []
    def track_monocular(self, image, t, imu=None):
        assert image.dtype == "uint8" and image.ndim == 2
        assert (imu is not None) == (self.sensor == "imu")
        if imu is not None:
            after = self.times[-1] if self.times else t - 0.1
            assert len(imu) >= 1 and (imu[:, 0] > after).all() and (imu[:, 0] <= t + 1e-9).all()
        assert not self.times or t > self.times[-1]
        self.times.append(t)
        return Result()
    def shutdown(self):
        pass
    def save_trajectory_euroc(self, path):
        open(path, "w").write(ROWS)
    def save_keyframe_trajectory_euroc(self, path):
        open(path, "w").write(ROWS.split("\\n")[1] + "\\n")
"""


def fake_environment(folder: Path, package: str) -> str:
    """A virtual environment whose Python has a stand-in for pyorbslam3."""
    site = folder / "lib" / "python3.11" / "site-packages" / "pyorbslam3"
    site.mkdir(parents=True)
    (site / "__init__.py").write_text(package)
    (site / "_core.so").write_bytes(b"")
    (folder / "bin").mkdir()
    python = folder / "bin" / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{site.parent}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    return f"venv:{folder}"


def test_the_bindings_are_driven_in_a_named_environment(
    sequence: TinySequence, vocabulary: Path, tmp_path: Path
) -> None:
    place = fake_environment(tmp_path / "env", f"ROWS = {saved(sequence)!r}\n{FAKE_PACKAGE}")
    config = OrbSlam3Config(run_in=place, pace=0, levels=2)
    assert OrbSlam3.missing(config) is None
    run = run_method(OrbSlam3(config), sequence)
    assert len(run.estimate.trajectory) == 6
    assert run.estimate.keyframes == [0]
    assert sorted(run.estimate.frames) == list(range(6))
    assert all(0 <= numbers["program_tracking_s"] < 60 for numbers in run.estimate.frames.values())
    assert any("6 of 6 frames tracked live" in line for line in run.log)


def test_with_an_imu_it_answers_with_body_poses(sequence: TinySequence, vocabulary: Path, tmp_path: Path) -> None:
    truth = sequence.groundtruth
    assert truth is not None
    bodies = Trajectory(truth.times, truth.T_wc @ invert_pose(T_BODY_CAM))
    rows = "".join(f"{t * 1e9:.6f} " + " ".join(f"{v:.9f}" for v in rest) + "\n" for t, *rest in pose_rows(bodies))
    place = fake_environment(tmp_path / "env", f"ROWS = {rows!r}\n{FAKE_PACKAGE}")
    config = OrbSlam3InertialConfig(run_in=place, pace=0, levels=2)
    estimate = run_method(
        OrbSlam3Inertial(config), TinySequence(PINHOLE, n=6, T_body_cam=T_BODY_CAM), needs=INERTIAL.needs
    ).estimate
    assert estimate.metric
    assert np.allclose(estimate.trajectory.positions, truth.positions, atol=1e-6)


def test_the_imu_s_settings_are_densities_and_its_pose_is_in_single_precision(tmp_path: Path) -> None:
    times = np.arange(400) / 200.0
    noise = np.random.default_rng(1).normal(size=(400, 6)) * [*[0.002] * 3, *[0.02] * 3]
    imu = Imu(times, noise[:, :3], noise[:, 3:] + [0, 0, 9.81])
    values = OrbSlam3Inertial().imu_settings(imu, make_pose(np.eye(3), [0.05, -0.02, 0.1]))
    assert values["IMU.NoiseGyro"] == pytest.approx(0.002 / np.sqrt(200), rel=0.15)
    assert values["IMU.NoiseAcc"] == pytest.approx(0.02 / np.sqrt(200), rel=0.15)
    (tmp_path / "s.yaml").write_text(opencv_yaml(values))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert file.getNode("IMU.T_b_c1").mat().dtype == np.float32
    assert file.getNode("IMU.Frequency").real() == pytest.approx(200)


def test_lost_from_the_first_frame_is_an_empty_answer(sequence: TinySequence, vocabulary: Path, tmp_path: Path) -> None:
    package = f"ROWS = ''\n{FAKE_PACKAGE}".replace('pose_valid = "OK", True', 'pose_valid = "LOST", False')
    place = fake_environment(tmp_path / "env", package)
    estimate = run_method(OrbSlam3(OrbSlam3Config(run_in=place, pace=0, levels=2)), sequence).estimate
    assert len(estimate.trajectory) == 0


def test_an_environment_without_the_package_says_how_to_get_it(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)
    reason = OrbSlam3.missing(OrbSlam3Config(run_in=f"venv:{tmp_path}"))
    assert reason is not None
    assert "pyorbslam3 is not installed" in reason


def test_settings_hold_the_cameras_in_opencv_pixels(tmp_path: Path) -> None:
    values = {"model": "pinhole", "width": 96, "height": 64, "fx": 50.0, "fy": 51.0, "cx": 48.0, "cy": 32.0}
    distorted = camera_from_dict({**values, "distortion": [0.1, -0.02, 0.001, 0.002]})
    (tmp_path / "s.yaml").write_text(opencv_yaml(OrbSlam3(OrbSlam3Config(levels=2)).settings(distorted, 29.97)))
    file = cv2.FileStorage(str(tmp_path / "s.yaml"), cv2.FILE_STORAGE_READ)
    assert file.getNode("Camera1.cx").real() == 47.5
    assert file.getNode("Camera1.k2").real() == -0.02
    assert file.getNode("Camera.fps").isInt()
    assert file.getNode("Camera1.fx").isReal()
    assert file.getNode("Camera.type").string() == "PinHole"
    fisheye = OrbSlam3(OrbSlam3Config(levels=2)).settings(fisheye_camera(96, 120), 10.0)
    assert fisheye["Camera.type"] == "KannalaBrandt8"
    assert fisheye["Camera1.k4"] == 0.0


def test_a_fisheye_is_shown_as_far_as_the_program_can_see(vocabulary: Path, tmp_path: Path) -> None:
    lens = fisheye_camera(96, 190)
    sequence = TinySequence(lens, n=2)
    method = OrbSlam3Binary(OrbSlamConfig(levels=2))
    method.prepare(sequence, MethodContext(work=tmp_path))
    written = sorted((tmp_path / "sequence" / "mav0" / "cam0" / "data").glob("*.png"))
    image = cv2.imread(str(written[0]), cv2.IMREAD_GRAYSCALE)
    angle = np.rad2deg(np.arccos(np.clip(lens.rays()[..., 2], -1, 1)))
    assert image[angle < 84].mean() > 20
    assert image[angle > 86].max() == 0
    assert OrbSlam3().visible_pixels(PINHOLE) is None


def test_images_on_which_it_crashes_are_refused() -> None:
    """ORB-SLAM3 ended with a C++ exception on views of 288x96: rows / 1.2^7 is less than the margin it leaves out."""
    small = pinhole_camera(288, 120, 60)  # the view that goes with panoramas of 512 pixels
    assert small.height == 96
    with pytest.raises(UnsupportedError, match=r"288x96 pixels are too few for 8 .*--set levels=6$"):
        OrbSlam3(OrbSlam3Config()).settings(small, 10.0)
    assert OrbSlam3(OrbSlam3Config(levels=6)).settings(small, 10.0)["ORBextractor.nLevels"] == 6
    assert OrbSlam3(OrbSlam3Config(scale_factor=1.1)).settings(small, 10.0)["ORBextractor.nLevels"] == 8
    with pytest.raises(UnsupportedError, match=r"give a larger --width$"):
        OrbSlam3(OrbSlam3Config()).settings(pinhole_camera(32, 90, 90), 10.0)


def test_a_panorama_is_refused() -> None:
    with pytest.raises(UnsupportedError, match="no erp camera"):
        OrbSlam3(OrbSlam3Config()).settings(TinySequence().camera, 10.0)


def test_the_png_reader_of_the_runner_agrees_with_opencv() -> None:
    image = cv2.cvtColor(TinySequence(PINHOLE, n=1).image(0), cv2.COLOR_RGB2GRAY)
    for strategy in (cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_STRATEGY_FILTERED):
        data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, strategy])[1].tobytes()
        assert np.array_equal(decode_grey_png(data), image)


@pytest.mark.skipif(importlib.util.find_spec("pyorbslam3") is None, reason="pyorbslam3 is not installed")
@pytest.mark.skipif(OrbSlam3.missing() is not None, reason="pyorbslam3's shared libraries are not installed")
def test_the_genuine_orbslam3_follows_a_camera_past_a_corner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = pinhole_camera(480, 80, 64)
    training = CornerRoom(camera, n=2, seed=9)
    tree = train_vocabulary(orb_descriptors(training.image(i) for i in range(2)), levels=3)
    (tmp_path / "voc.txt").write_text(tree.text())
    monkeypatch.setenv(VOCABULARY_VARIABLE, str(tmp_path / "voc.txt"))
    sequence = CornerRoom(camera, n=40, rate=20.0, pose=past_the_corner)
    errors = []
    for _ in range(3):  # its threads race: on a busy machine a run may start its map badly
        run = run_method(OrbSlam3(OrbSlam3Config(timeout_s=120, pace=1.5)), sequence)
        tracked = len(run.estimate.trajectory)
        errors.append(ate_rmse(run, sequence) if tracked >= 20 else np.inf)
        if errors[-1] < 0.03:
            break
    assert min(errors) < 0.03, errors
    assert len(run.estimate.keyframes) >= 2


def past_the_corner(t: float) -> np.ndarray:
    """Sideways, looking into a corner: two walls, ceiling and floor, since a single plane starts no map reliably."""
    R = so3_exp([0.05 * np.sin(t), 0.85 + 0.1 * np.sin(0.7 * t), 0.0])
    return make_pose(R, [0.7 * np.sin(0.6 * t), 0.2 * np.sin(1.1 * t), -0.7 * np.sin(0.6 * t)])


class CornerRoom(TinySequence):
    """The tiny room papered with random checkers of 37 and 13 cm: ORB needs corners."""

    def image_from(self, T_wc: np.ndarray, camera: Camera | None = None) -> np.ndarray:
        camera = camera or self.camera
        _, points = self._hits(T_wc, camera.rays())
        grey = np.zeros(points.shape[:2], np.float32)
        for size in (0.37, 0.13):
            cell = np.floor(np.nan_to_num(points) / size + 0.31).astype(np.int64)
            mixed = cell @ np.array([73856093, 19349663, 83492791]) + int(1e6 * self._phases[0, 0])
            grey += 0.5 * ((mixed ^ (mixed >> 7)) * 2654435761 % 2**32 >> 24)
        grey = cv2.GaussianBlur(grey, (0, 0), 0.8)
        return np.repeat(grey[..., None], 3, axis=-1).astype(np.uint8)

"""Photo-SLAM's adapter against a stand-in with tum_mono's command line and files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from panobench_photo_slam import SPEC
from panobench_photo_slam.method import MAPPER, PhotoSlam, PhotoSlamConfig

from panobench import MethodError, UnsupportedError
from panobench.external import VOCABULARY_VARIABLE, opencv_yaml
from panobench.testing import (
    TinySequence,
    assert_conforms,
    ate_rmse,
    pinhole_camera,
    pose_rows,
    run_method,
    write_program,
)

CAMERA = pinhole_camera(64, 90, 70)
PLY = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n0\n1\n"
TUM_MONO = """
import os, sys
vocabulary, orb, mapper, sequence, output, viewer = sys.argv[1:]
assert viewer == "no_viewer" and open(vocabulary).readline()
assert "Camera1.fx: " in open(orb).read() and "Optimization.max_num_iterations: 200" in open(mapper).read()
lines = open(sequence + "/rgb.txt").read().splitlines()
assert all(line.startswith("#") for line in lines[:3])
for line in lines[3:]:
    assert os.path.exists(sequence + "/" + line.split()[1])
open(output + "/CameraTrajectory_TUM.txt", "w").write(%r)
open(output + "/KeyFrameTrajectory_TUM.txt", "w").write(%r)
folder = output + "/200_shutdown/ply/point_cloud/iteration_200"
os.makedirs(folder)
open(folder + "/point_cloud.ply", "w").write(%r)
"""


@pytest.fixture(autouse=True)
def vocabulary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "ORBvoc.txt"
    path.write_text("10 6 0 0\n")
    monkeypatch.setenv(VOCABULARY_VARIABLE, str(path))


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_PHOTO_SLAM_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_images_go_in_and_poses_and_a_map_come_out(tmp_path: Path) -> None:
    sequence = TinySequence(CAMERA, n=5)
    assert sequence.groundtruth is not None
    rows = [" ".join(f"{v:.9f}" for v in row) + "\n" for row in pose_rows(sequence.groundtruth)]
    path = write_program(tmp_path / "tum_mono", TUM_MONO % ("".join(rows), rows[1], PLY))
    run = run_method(PhotoSlam(PhotoSlamConfig(command=str(path), iterations=200, levels=2)), sequence)
    assert np.allclose(run.estimate.trajectory.times, sequence.times)
    assert ate_rmse(run, sequence) < 1e-6
    assert run.estimate.keyframes == [1]
    assert run.estimate.map is not None
    assert len(run.estimate.map) == 2
    run.estimate.map.write_ply(tmp_path / "map.ply")  # the work folder is gone by now
    assert (tmp_path / "map.ply").read_text() == PLY


def test_a_missing_gpu_shows_in_the_log(tmp_path: Path) -> None:
    code = "import sys; print('Training on CPU.'); print('CUDA error: no device'); sys.exit(134)"
    path = write_program(tmp_path / "tum_mono", code)
    with pytest.raises(MethodError, match=r"exit code 134; the log ends: Training on CPU\. \| CUDA error: no device"):
        run_method(PhotoSlam(PhotoSlamConfig(command=str(path), levels=2)), TinySequence(CAMERA, n=2))


def test_panoramas_are_refused() -> None:
    with pytest.raises(UnsupportedError, match="takes pinhole images, not erp"):
        run_method(PhotoSlam(PhotoSlamConfig(command="true")), TinySequence(n=2))


def test_the_mappers_settings_keep_their_types_in_opencv(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(opencv_yaml(MAPPER))
    file = cv2.FileStorage(str(tmp_path / "m.yaml"), cv2.FILE_STORAGE_READ)
    for key, value in MAPPER.items():
        node = file.getNode(key)
        assert node.isInt() if isinstance(value, int) else node.isReal(), key
        assert (int(node.real()) if isinstance(value, int) else node.real()) == value

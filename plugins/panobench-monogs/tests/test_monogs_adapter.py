"""MonoGS's adapter: its exporter runs for real, against a stand-in for MonoGS's folder."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from panobench_monogs import SPEC
from panobench_monogs.method import BASE_CONFIG, MonoGs, MonoGsConfig

from panobench import MethodError, UnavailableError
from panobench.geometry import invert_pose
from panobench.testing import TinySequence, assert_conforms, ate_rmse, pinhole_camera, run_method

CAMERA = pinhole_camera(64, 90, 70)
#: As MonoGS's slam.py: reads its YAML, reads the TUM folder, ends with eval_ate(..., final=True).
SLAM = """
import argparse, os
import numpy as np
import yaml
from utils.slam_frontend import run

parser = argparse.ArgumentParser()
parser.add_argument("--config")
config = yaml.safe_load(open(parser.parse_args().config))
base = yaml.safe_load(open(config["inherit_from"]))
assert base["Training"]["window_size"] == 8
assert config["Results"]["use_gui"] is False and config["Dataset"]["sensor_type"] == "monocular"
folder = config["Dataset"]["dataset_path"]
images = np.loadtxt(folder + "/rgb.txt", dtype=str)
truth = np.loadtxt(folder + "/groundtruth.txt", skiprows=1)
depth = np.loadtxt(folder + "/depth.txt", dtype=str)
assert len(images) == len(truth) == len(depth)
assert all(os.path.exists(folder + "/" + name) for name in images[:, 1])
assert np.diff(images[:, 0].astype(float)).min() > 1 / 32
assert np.allclose(truth[0, 1:], [0, 0, 0, 0, 0, 0, 1])
assert np.linalg.matrix_rank(np.cov(truth[:, 1:4].T)) == 3
run(len(images))
"""
FRONTEND = """
import numpy as np

class Tensor:
    def __init__(self, value):
        self.value = value
    def detach(self):
        return self
    cpu = detach
    def numpy(self):
        return np.asarray(self.value, dtype=np.float32)

class Camera:
    def __init__(self, T_cw):
        self.R, self.T = Tensor(T_cw[:3, :3]), Tensor(T_cw[:3, 3])

def eval_ate(frames, kf_ids, save_dir, iterations, final=False, monocular=False):
    print("evaluated", len(frames), "frames", flush=True)

def run(n):
    poses = np.load(POSES)
    frames = {i: Camera(poses[i]) for i in range(n)}
    eval_ate(frames, [0], "x", 5)
    eval_ate(frames, [0, 2], "x", 0, final=True, monocular=True)
"""


@pytest.fixture
def sequence() -> TinySequence:
    return TinySequence(CAMERA, n=5, rate=40.0)  # faster than MonoGS's reader takes them


def checkout(folder: Path, sequence: TinySequence, slam: str = SLAM) -> MonoGsConfig:
    (folder / "utils").mkdir(parents=True)
    (folder / BASE_CONFIG).parent.mkdir(parents=True)
    (folder / BASE_CONFIG).write_text("Training: {window_size: 8}\n")
    (folder / "utils" / "__init__.py").write_text("")
    assert sequence.groundtruth is not None
    np.save(folder / "poses.npy", invert_pose(sequence.groundtruth.T_wc))
    (folder / "utils" / "slam_frontend.py").write_text(f"POSES = {str(folder / 'poses.npy')!r}\n{FRONTEND}")
    (folder / "slam.py").write_text(slam)
    return MonoGsConfig(home=str(folder), command=sys.executable)


def test_it_keeps_the_contract() -> None:
    assert_conforms(SPEC)


def test_the_poses_of_all_frames_come_back(sequence: TinySequence, tmp_path: Path) -> None:
    run = run_method(MonoGs(checkout(tmp_path / "MonoGS", sequence)), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert np.allclose(run.estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-5)  # type: ignore[union-attr]
    assert ate_rmse(run, sequence) < 1e-5
    assert run.estimate.keyframes == [0, 2]
    assert any("evaluated 5 frames" in line for line in run.log)


def test_a_traceback_of_its_own_is_shown(sequence: TinySequence, tmp_path: Path) -> None:
    config = checkout(tmp_path / "MonoGS", sequence, "raise RuntimeError('No CUDA GPUs are available')")
    with pytest.raises(MethodError, match="RuntimeError: No CUDA GPUs are available"):
        run_method(MonoGs(config), sequence)


def test_it_says_what_to_name(sequence: TinySequence, tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="name its folder in PANOBENCH_MONOGS_HOME"):
        run_method(MonoGs(), sequence)
    assert "no slam.py" in str(MonoGs.missing(MonoGsConfig(home=str(tmp_path))))

"""MonoGS's adapter: its exporter runs for real, against a stand-in for MonoGS's folder."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from panobench_monogs import SPEC
from panobench_monogs.method import BASE_CONFIG, MonoGs, MonoGsConfig

from panobench import MethodError, UnavailableError
from panobench.geometry import invert_pose
from panobench.testing import TinySequence, assert_conforms, ate_rmse, pinhole_camera, run_method

CAMERA = pinhole_camera(64, 90, 70)
COLOUR, SCALE, ROTATION = ("f_dc_0 f_dc_1 f_dc_2", "scale_0 scale_1 scale_2", "rot_0 rot_1 rot_2 rot_3")
NAMES = f"x y z nx ny nz {COLOUR} opacity {SCALE} {ROTATION}".split()
HEADER = ["ply", "format ascii 1.0", "element vertex 1", *(f"property float {n}" for n in NAMES), "end_header"]
#: A red Gaussian two units ahead of the first camera.
PLY = "\n".join([*HEADER, "0 0 2 0 0 0 1.77 -1.77 -1.77 6 -1 -1 -1 1 0 0 0", ""])
#: As MonoGS's slam.py: reads its YAML and the TUM folder, starts a back end, runs the front end, and waits for the back
#: end, which hangs here as the genuine one sometimes does.
SLAM = """
import argparse, multiprocessing, os, time
import numpy as np
import yaml
from utils.slam_frontend import FrontEnd

def back_end():
    time.sleep(600)

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    config = yaml.safe_load(open(parser.parse_args().config))
    base = yaml.safe_load(open(config["inherit_from"]))
    assert base["Training"]["window_size"] == 8
    assert config["Training"]["single_thread"] is config["Dataset"]["single_thread"] is SINGLE
    assert config["Results"]["use_gui"] is False and config["Dataset"]["sensor_type"] == "monocular"
    assert "depth_scale" not in config["Dataset"]["Calibration"]
    folder = config["Dataset"]["dataset_path"]
    images = np.loadtxt(folder + "/rgb.txt", dtype=str)
    truth = np.loadtxt(folder + "/groundtruth.txt", skiprows=1)
    depth = np.loadtxt(folder + "/depth.txt", dtype=str)
    assert len(images) == len(truth) == len(depth)
    assert all(os.path.exists(folder + "/" + name) for name in images[:, 1])
    assert np.diff(images[:, 0].astype(float)).min() > 1 / 32
    assert np.allclose(truth[0, 1:], [0, 0, 0, 0, 0, 0, 1])
    process = multiprocessing.get_context("fork").Process(target=back_end)
    process.start()
    print("back end", process.pid, flush=True)
    FrontEnd().run(len(images))
    process.join()
"""
#: As MonoGS's front end: cameras of a map that was given up stay in the table, in their own world.
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
        if NEWER:
            self.T = Tensor(T_cw)
        else:
            self.R, self.T = Tensor(T_cw[:3, :3]), Tensor(T_cw[:3, 3])

class Gaussians:
    def save_ply(self, path):
        open(path, "wb").write(open(MAP, "rb").read())

def eval_ate(cameras, kf_ids, save_dir, iterations, final=False, monocular=False):
    print("evaluated", len(kf_ids), "keyframes", flush=True)
    assert not final, "its own final evaluation is left out"

def save_gaussians(gaussians, name, iteration, final=False):
    raise RuntimeError("not reached")

class FrontEnd:
    def run(self, n):
        poses = np.load(POSES)
        cameras = {i: Camera(poses[i] if i >= RESET else np.eye(4)) for i in range(n)}
        keyframes = [k for k in (0, 2, 4) if k >= RESET]
        eval_ate(cameras, keyframes, "x", 5)
        eval_ate(cameras, keyframes, "x", 0, final=True, monocular=True)
        save_gaussians(Gaussians(), "x", "final", final=True)
"""


@pytest.fixture
def sequence() -> TinySequence:
    return TinySequence(CAMERA, n=5, rate=40.0)  # faster than MonoGS's reader takes them


def checkout(
    folder: Path, sequence: TinySequence, slam: str = SLAM, *, reset: int = 0, newer: bool = False, single: bool = False
) -> MonoGsConfig:
    """A stand-in for MonoGS's folder whose last map starts at frame ``reset``."""
    (folder / "utils").mkdir(parents=True)
    (folder / BASE_CONFIG).parent.mkdir(parents=True)
    (folder / BASE_CONFIG).write_text("Training: {window_size: 8}\n")
    (folder / "utils" / "__init__.py").write_text("")
    assert sequence.groundtruth is not None
    np.save(folder / "poses.npy", invert_pose(sequence.groundtruth.T_wc))
    (folder / "map.ply").write_text(PLY)
    constants = {"POSES": str(folder / "poses.npy"), "MAP": str(folder / "map.ply"), "RESET": reset, "NEWER": newer}
    lines = "".join(f"{name} = {value!r}\n" for name, value in constants.items())
    (folder / "utils" / "slam_frontend.py").write_text(lines + FRONTEND)
    (folder / "slam.py").write_text(f"SINGLE = {single}\n{slam}")
    return MonoGsConfig(home=str(folder), command=sys.executable, single_thread=single)


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_MONOGS_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


@pytest.mark.parametrize("newer", [False, True], ids=["R and T", "T is 4x4"])
def test_the_poses_of_all_frames_and_the_map_come_back(sequence: TinySequence, tmp_path: Path, newer: bool) -> None:
    method = MonoGs(checkout(tmp_path / "MonoGS", sequence, newer=newer, single=newer))
    run = run_method(method, sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert np.allclose(run.estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-5)  # type: ignore[union-attr]
    assert ate_rmse(run, sequence) < 1e-5
    assert run.estimate.keyframes == [0, 2, 4]
    assert run.estimate.map is not None
    assert len(run.estimate.map) == 1
    image = method.render(CAMERA, np.eye(4))
    assert image is not None
    assert image[CAMERA.height // 2, CAMERA.width // 2, 0] > 0.9


def test_frames_before_a_reset_are_left_out(sequence: TinySequence, tmp_path: Path) -> None:
    """They are in the world of a map that is gone."""
    run = run_method(MonoGs(checkout(tmp_path / "MonoGS", sequence, reset=2)), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times[2:])
    assert run.estimate.keyframes == [2, 4]
    assert ate_rmse(run, sequence) < 1e-5


def test_a_back_end_that_hangs_ends_with_the_run(sequence: TinySequence, tmp_path: Path) -> None:
    begin = time.monotonic()
    run = run_method(MonoGs(checkout(tmp_path / "MonoGS", sequence)), sequence)
    assert time.monotonic() - begin < 60
    pid = next(int(line.split()[-1]) for line in run.log if "back end" in line)
    assert not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_a_traceback_of_its_own_is_shown(sequence: TinySequence, tmp_path: Path) -> None:
    config = checkout(tmp_path / "MonoGS", sequence, "raise RuntimeError('No CUDA GPUs are available')")
    with pytest.raises(MethodError, match="RuntimeError: No CUDA GPUs are available"):
        run_method(MonoGs(config), sequence)


def test_it_says_what_to_name(sequence: TinySequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PANOBENCH_MONOGS_HOME", raising=False)
    with pytest.raises(UnavailableError, match="name its folder in PANOBENCH_MONOGS_HOME"):
        run_method(MonoGs(), sequence)
    assert "no slam.py" in str(MonoGs.missing(MonoGsConfig(home=str(tmp_path))))

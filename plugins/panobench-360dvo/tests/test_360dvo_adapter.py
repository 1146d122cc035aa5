"""360DVO's adapter against a stand-in for its folder, with demo.py's command line and files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from panobench_360dvo import SPEC
from panobench_360dvo.method import Dvo360, Dvo360Config

from panobench import MethodError, UnavailableError, UnsupportedError
from panobench.testing import TinySequence, assert_conforms, ate_rmse, erp_camera, pinhole_camera, pose_rows, run_method

#: As 360DVO's demo.py: it reads a folder's images in the order of their names, numbers them, and writes below the
#: folder in which it runs.
DEMO = """
import argparse, os
from pathlib import Path
from dpvo import read_size

parser = argparse.ArgumentParser()
parser.add_argument("--network", default="360dvo.pth")
parser.add_argument("--imagedir")
parser.add_argument("--stride", type=int, default=1)
parser.add_argument("--skip", type=int, default=0)
parser.add_argument("--config", default="config/360.yaml")
parser.add_argument("--viz", action="store_true")
parser.add_argument("--save_trajectory", action="store_true")
parser.add_argument("--save_ply", action="store_true")
parser.add_argument("--plot", action="store_true")
parser.add_argument("--name", default="result")
args = parser.parse_args()
assert open(args.network).read() == "weights" and "PATCHES_PER_FRAME" in open(args.config).read()
names = sorted(os.listdir(args.imagedir))
assert len(names) == len(ROWS)
assert all(read_size(os.path.join(args.imagedir, name)) == (64, 32) for name in names)
if args.save_trajectory:
    Path("saved_trajectories").mkdir(exist_ok=True)
    lines = [f"{float(i)} " + " ".join(map(str, row)) for i, row in enumerate(ROWS)]
    Path(f"saved_trajectories/{args.name}.txt").write_text("\\n".join(lines) + "\\n")
"""
READ_SIZE = """
import struct

def read_size(path):
    return struct.unpack(">II", open(path, "rb").read()[16:24])
"""


@pytest.fixture
def sequence() -> TinySequence:
    return TinySequence(erp_camera(64), n=5)


def checkout(folder: Path, sequence: TinySequence, demo: str = DEMO) -> Dvo360Config:
    """A stand-in for 360DVO's folder."""
    (folder / "dpvo").mkdir(parents=True)
    (folder / "config").mkdir()
    (folder / "dpvo" / "__init__.py").write_text(READ_SIZE)
    (folder / "config" / "360.yaml").write_text("PATCHES_PER_FRAME: 96\n")
    (folder / "360dvo.pth").write_text("weights")
    assert sequence.groundtruth is not None
    rows = [[float(v) for v in rest] for _, *rest in pose_rows(sequence.groundtruth)]
    (folder / "demo.py").write_text(f"ROWS = {rows!r}\n{demo}")
    return Dvo360Config(home=str(folder), command=sys.executable)


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_360DVO_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_every_frame_is_answered(sequence: TinySequence, tmp_path: Path) -> None:
    run = run_method(Dvo360(checkout(tmp_path / "360DVO", sequence)), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert np.allclose(run.estimate.trajectory.T_wc, sequence.groundtruth.T_wc, atol=1e-5)  # type: ignore[union-attr]
    assert ate_rmse(run, sequence) < 1e-5


def test_a_traceback_of_its_own_is_shown(sequence: TinySequence, tmp_path: Path) -> None:
    config = checkout(tmp_path / "360DVO", sequence, "raise RuntimeError('No CUDA GPUs are available')")
    with pytest.raises(MethodError, match="RuntimeError: No CUDA GPUs are available"):
        run_method(Dvo360(config), sequence)


def test_it_says_what_to_name(sequence: TinySequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PANOBENCH_360DVO_HOME", raising=False)
    with pytest.raises(UnavailableError, match="name its folder in PANOBENCH_360DVO_HOME"):
        run_method(Dvo360(), sequence)
    assert "no demo.py" in str(Dvo360.missing(Dvo360Config(home=str(tmp_path))))
    config = checkout(tmp_path / "360DVO", sequence)
    (tmp_path / "360DVO" / "360dvo.pth").unlink()
    assert "weights are not there" in str(Dvo360.missing(config))


def test_images_that_it_would_cut_are_refused(tmp_path: Path, sequence: TinySequence) -> None:
    config = checkout(tmp_path / "360DVO", sequence)
    with pytest.raises(UnsupportedError, match="multiple of 16, not 80x40"):
        run_method(Dvo360(config), TinySequence(erp_camera(80), n=2))
    with pytest.raises(UnsupportedError, match="not pinhole images"):
        run_method(Dvo360(config), TinySequence(pinhole_camera(64, 90, 70), n=2))

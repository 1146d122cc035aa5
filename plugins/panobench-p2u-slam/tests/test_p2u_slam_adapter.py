"""P2U-SLAM's adapter against a stand-in with the interface it is expected to have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from panobench_p2u_slam import SPEC
from panobench_p2u_slam.method import P2uSlam, P2uSlamConfig

from panobench import UnavailableError, UnsupportedError
from panobench.external import VOCABULARY_VARIABLE
from panobench.testing import (
    TinySequence,
    annular_camera,
    assert_conforms,
    ate_rmse,
    fisheye_camera,
    pose_rows,
    run_method,
    write_program,
)

PAL = annular_camera()
STAND_IN = """
import sys
vocabulary, settings, folder, times, name = sys.argv[1:]
text = open(settings).read()
assert 'Camera.type: "Taylor"' in text and "Camera1.poly4: " in text and "Camera.mask: " in text, text
for stamp in open(times).read().split():
    assert open(f"{folder}/mav0/cam0/data/{stamp}.png", "rb").read(4) == b"\\x89PNG"
open(f"f_{name}.txt", "w").write(%r)
"""


@pytest.fixture(autouse=True)
def vocabulary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "ORBvoc.txt"
    path.write_text("10 6 0 0\n")
    monkeypatch.setenv(VOCABULARY_VARIABLE, str(path))


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_P2U_SLAM_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_annular_images_go_in_and_poses_come_out(tmp_path: Path) -> None:
    sequence = TinySequence(PAL, n=5)
    assert sequence.groundtruth is not None
    rows = "".join(
        f"{t * 1e9:.0f} " + " ".join(f"{v:.9f}" for v in r) + "\n" for t, *r in pose_rows(sequence.groundtruth)
    )
    path = write_program(tmp_path / "p2u", STAND_IN % rows)
    run = run_method(P2uSlam(P2uSlamConfig(command=str(path), levels=2)), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert ate_rmse(run, sequence) < 1e-6


def test_its_absence_is_said_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_P2U_SLAM_COMMAND", "no-such-program")
    assert str(P2uSlam.missing()).startswith("no public code at present")
    with pytest.raises(UnavailableError):
        run_method(P2uSlam(), TinySequence(PAL, n=2))


def test_its_other_cameras() -> None:
    assert P2uSlam(P2uSlamConfig(levels=2)).settings(fisheye_camera(96, 120), 20.0)["Camera.type"] == "KannalaBrandt8"
    with pytest.raises(UnsupportedError, match="no erp camera"):
        P2uSlam().settings(TinySequence().camera, 20.0)

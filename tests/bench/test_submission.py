"""Files for the Hilti challenge from stored runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.bench.records.record import FramesRecord, MethodRecord, RunRecord, SpecRecord, write_record
from panobench.bench.records.runfolder import FRAMES, TRAJECTORY, write_frames
from panobench.bench.records.submission import check_file, write_submission
from panobench.cli.main import run as command
from panobench.datasets.files.trajectory_io import read_tum, write_tum
from panobench.datasets.hilti.calibration import published_calibration
from panobench.errors import InputError, UsageError
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.types import Trajectory

NAME = "floor_2_2025-10-28_run_1"
TIMES = 10_000 + np.arange(300) / 30


def poses() -> np.ndarray:
    t = TIMES - TIMES[0]
    R = so3_exp(np.stack([0.1 * np.sin(t), t, 0 * t], axis=-1))
    return make_pose(R, np.stack([t, np.sin(t), 0 * t], axis=-1))


def stored(
    folder: Path,
    sequence: str = NAME,
    dataset: str = "hilti-360",
    missing: int = 0,
    metric: bool = True,
    turned: np.ndarray | None = None,
    **options: Any,
) -> Path:
    """A run folder as far as a submission needs it; poses are those of the rig, or of a camera turned in it."""
    folder.mkdir(parents=True)
    record = RunRecord(
        status="ok",
        spec=SpecRecord(other={"method": "m", "dataset": dataset, "sequence": sequence, **options}),
        method=MethodRecord(name="m"),
        metric=metric,
        frames=FramesRecord(given=len(TIMES), planned=len(TIMES), tracked=len(TIMES) - missing),
    )
    record.provenance.dataset = {"T_cam0_rig": published_calibration().T_cam0_rig.tolist()}
    T = poses()
    if turned is not None:
        record.provenance.dataset["conversion"] = {"R_target_source": turned.tolist()}
        T = T @ make_pose(turned.T, np.zeros(3))
    write_record(folder, record)
    write_tum(folder / TRAJECTORY, Trajectory(TIMES, T).select(np.arange(missing, len(TIMES))))
    write_frames(folder / FRAMES, [{"index": i, "time": f"{t:.9f}"} for i, t in enumerate(TIMES)])
    return folder


@pytest.mark.parametrize("turned", [None, so3_exp([0.2, -1.0, 0.3])])
def test_the_file_has_the_poses_of_cam0(tmp_path: Path, turned: np.ndarray | None) -> None:
    (done,) = write_submission([stored(tmp_path / "run", turned=turned)], tmp_path / "out")
    assert done.file == tmp_path / "out" / f"{NAME}.txt"
    found = read_tum(done.file)
    np.testing.assert_allclose(found.times, TIMES, atol=1e-6)
    np.testing.assert_allclose(found.T_wc, poses() @ invert_pose(published_calibration().T_cam0_rig), atol=1e-6)
    assert len(check_file(done.file)) == 300


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"dataset": "rooms"}, "not on hilti-360"),
        ({"sequence": "walk"}, "not called floor_X"),
        ({"sequence": "floor_synthetic_2026-01-01_run_1"}, "no floor 'synthetic'"),
        ({"every": 2}, "part of the frames"),
        ({"missing": 155}, "145 of 150 frames after the first 5 s"),
        ({"missing": 300}, "no poses"),
    ],
)
def test_what_would_score_nothing_is_not_written(tmp_path: Path, changes: dict[str, Any], why: str) -> None:
    (done,) = write_submission([stored(tmp_path / "run", **changes)], tmp_path / "out")
    assert done.file is None
    assert why in "; ".join(done.problems)
    assert not (tmp_path / "out").exists()


def test_frames_before_the_judged_ones_may_be_missing(tmp_path: Path) -> None:
    (done,) = write_submission([stored(tmp_path / "run", missing=150)], tmp_path / "out")
    assert done.file is not None
    assert done.poses == 150


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stored(tmp_path / "runs" / "a", metric=False)
    stored(tmp_path / "runs" / "b", sequence="floor_EG_2025-10-28_run_2", max_frames=100)
    assert command(["submit", "hilti-360", str(tmp_path / "runs"), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert f"{NAME}.txt: 300 poses" in said
    assert "does not say that its scale is metres" in said
    assert "floor_EG_2025-10-28_run_2: not written: it has a part of the frames" in said
    assert [p.name for p in (tmp_path / "out").iterdir()] == [f"{NAME}.txt"]
    stored(tmp_path / "runs" / "c")
    with pytest.raises(UsageError, match="two runs on"):
        write_submission([tmp_path / "runs" / "a", tmp_path / "runs" / "c"], tmp_path / "out")


def test_files_that_the_organisers_would_not_read(tmp_path: Path) -> None:
    path = tmp_path / "walk.txt"
    write_tum(path, Trajectory(TIMES, poses()))
    with pytest.raises(InputError, match="must be called"):
        check_file(path)

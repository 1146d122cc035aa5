from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.record import write_record
from panobench.bench.records.rescore import Protocol, rescore
from panobench.datasets.files.trajectory_io import read_tum, write_tum
from panobench.errors import InputError
from panobench.geometry import Sim3, so3_exp
from panobench.report.collect import collect, read_run, trajectory_errors
from panobench.types import Trajectory


def test_a_run_folder_is_read_whole(make_run):
    run = read_run(make_run("r", noise=0.001, seed=3))
    assert (run.method, run.dataset, run.sequence, run.seed, run.status) == ("panogs", "rooms", "room1", 3, "ok")
    assert run.errors is not None
    assert run.errors.alignment == "Sim(3)"
    assert 0.001 < run.errors.rmse < 0.0025
    assert run.number("ate_percent") == pytest.approx(100 * run.number("ate_rmse_m") / run.groundtruth.path_length())
    assert run.number("lpips") is None
    assert run.number("map_gaussians") == 21034
    assert [pair.frame for pair in run.pairs] == [0, 10]
    assert all(pair.truth is not None for pair in run.pairs)
    assert run.depth is not None
    assert run.depth.span == (0.8, 3.9)
    assert len(run.frames["latency_s"]) == 40
    assert run.log_tail.endswith("finished")


def test_errors_vanish_for_a_similar_trajectory_and_scale_is_kept_when_asked_for(make_run):
    truth = read_tum(make_run("r") / "groundtruth.tum")
    moved = Sim3(2.5, so3_exp([0.3, -0.2, 1.0]), np.array([1.0, 2.0, 3.0])).apply_poses(truth.T_wc)
    similar = Trajectory(truth.times, moved)
    free = trajectory_errors(similar, truth, Protocol())
    assert free is not None
    assert free.rmse < 1e-9
    assert free.rotation.max() < 1e-5
    assert free.transform.scale == pytest.approx(0.4)
    assert free.transform.apply_points(similar.positions) == pytest.approx(truth.positions)
    fixed = trajectory_errors(similar, truth, Protocol("se3"))
    assert fixed is not None
    assert fixed.alignment == "SE(3)"
    assert fixed.rmse > 0.5
    raw = trajectory_errors(truth, truth, Protocol("none"))
    assert raw is not None
    assert raw.rmse == 0.0


def test_plots_use_the_alignment_the_run_was_scored_with(make_run, edit):
    folder = make_run("r")
    edit(folder, lambda d: d.update(metric=True))
    assert read_run(folder).errors.alignment == "SE(3)"
    edit(folder, lambda d: d.update(protocol="1.0+align=none"))
    assert read_run(folder).errors.alignment == "none"


@pytest.mark.parametrize("protocol", [Protocol(), Protocol("se3"), Protocol("none"), Protocol(skip_s=0.5)])
def test_curves_and_tables_say_the_same(make_run, protocol):
    """A pose 20 ms from its frame meets no true pose, in the table's figure and in the curve."""
    folder = make_run("r", noise=0.01)
    off = read_tum(folder / "trajectory.tum")
    times = off.times + np.where(np.arange(len(off)) % 5 == 3, 0.02, 0.0)
    write_tum(folder / "trajectory.tum", Trajectory(times, off.T_wc))
    scored = rescore(folder, protocol)
    write_record(folder, scored)
    run = read_run(folder)
    assert run.errors.rmse == pytest.approx(scored.number("ate_rmse_m"), rel=1e-9)
    assert np.sqrt(np.mean(run.errors.rotation**2)) == pytest.approx(scored.number("ate_rotation_rmse_deg"), rel=1e-9)
    assert len(run.errors.times) == 32 if protocol.skip_s == 0 else 26


def test_without_ground_truth_there_are_no_errors(make_run):
    run = read_run(make_run("r", truth=False))
    assert run.errors is None
    assert run.groundtruth is None
    assert run.trajectory is not None


def test_stores_are_searched_and_unreadable_runs_are_reported(make_run):
    store = make_run("good").parent
    broken = make_run("nested/broken")
    (broken / "run.json").write_text('{"schema": 1,\n "status"')
    old = make_run("old")
    (old / "run.json").write_text('{"schema": 0, "status": "ok"}')
    (store / ".part").mkdir()
    (store / ".part" / "run.json").write_text("{}")
    (store / "_quarantine" / "bad-20260101").mkdir(parents=True)
    found = collect([store, store / "good"])
    assert [r.folder.name for r in found.runs] == ["good"]
    assert {p.folder.name for p in found.problems} == {"broken", "old", "bad-20260101"}
    assert any("run.json:2" in p.message for p in found.problems)


def test_nothing_to_read_is_one_clear_error(tmp_path: Path, make_run):
    with pytest.raises(InputError, match="no such"):
        collect([tmp_path / "absent"])
    with pytest.raises(InputError, match=r"no run\.json"):
        collect([tmp_path])
    folder = make_run("x")
    (folder / "run.json").write_text("[]")
    with pytest.raises(InputError, match="can be read"):
        collect([folder])


def test_damaged_side_files_are_warnings(make_run):
    folder = make_run("r")
    (folder / "trajectory.tum").write_text("0 1 2 what\n")
    (folder / "renders" / "000000.jpg").write_bytes(b"not a picture")
    run = read_run(folder)
    assert run.trajectory is None
    assert len(run.warnings) == 1
    assert "trajectory.tum:1" in run.warnings[0]

"""Suites: which cells run, which results stand, and what is added to them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from suite_runs import Silent, cell, quick, run, statuses

from panobench.bench.records.record import CellRecord
from panobench.bench.records.runfolder import read_run_json
from panobench.bench.suite.cells import Limits, Planned, Planner
from panobench.bench.suite.isolated import InfrastructureError, Stopper, run_isolated
from panobench.bench.suite.runner import SuiteRunner, choose, make_plan, parse_retry
from panobench.bench.suite.store import Store
from panobench.errors import UnknownNameError
from panobench.types import RunStatus

pytestmark = pytest.mark.usefixtures("fake_plugin")


def test_the_same_command_again_runs_nothing(tmp_path: Path) -> None:
    store, cells = Store(tmp_path), [cell(seed=0), cell(seed=1), cell("crash"), cell("absent")]
    assert len(run(store, cells).notes) == 2 * len(cells)
    assert statuses(store, cells) == ["ok", "ok", "crashed", "unavailable"]
    before = {f: (f / "run.json").stat().st_mtime_ns for f in (tmp_path / "runs").iterdir()}
    assert run(store, cells).notes == []
    assert {f: (f / "run.json").stat().st_mtime_ns for f in (tmp_path / "runs").iterdir()} == before
    entry = read_run_json(store.folder(cells[0]))["cell"]
    assert entry["suite"] == "test"
    assert entry["label"] == "fake-still erp 64 px 4 frames tiny/blind seed 0"


def test_external_programs_that_fail_are_rows_and_the_suite_goes_on(tmp_path: Path) -> None:
    ways = ["work", "crash", "hang", "silent", "partial", "malformed", "stray", "works"]
    patience = {"hang": "5"}  # enough to say what it is about to do
    cells = [cell("program", settings={"extra": way, "timeout_s": patience.get(way, "60")}) for way in ways]
    store = Store(tmp_path / "store")
    run(store, cells)
    expected = ["ok", "crashed", "timeout", "crashed", "crashed", "crashed", "crashed", "ok"]
    assert statuses(store, cells) == expected
    for way, chosen in zip(ways, cells):
        document = read_run_json(store.folder(chosen))
        assert bool(document["message"]) != way.startswith("work"), way
        if way in ("crash", "hang", "silent", "partial", "malformed"):
            assert f"about to {way}" in (store.folder(chosen) / "log.txt").read_text(), way
    assert not list(tmp_path.rglob("stray.txt"))


def test_a_suite_is_amended(tmp_path: Path) -> None:
    store = Store(tmp_path)
    run(store, [cell(seed=0)])
    assert [label for _, label in run(store, [cell(seed=0), cell(seed=1)]).notes] == [cell(seed=1).label] * 2


def test_retry_chooses_by_status(tmp_path: Path) -> None:
    store, cells = Store(tmp_path), [cell(), cell("crash"), cell("loses-track", max_frames=12)]
    run(store, cells)
    assert statuses(store, cells) == ["ok", "crashed", "lost"]
    assert {label for _, label in run(store, cells, "failed").notes} == {cells[1].label}
    assert {label for _, label in run(store, cells, "failed,lost").notes} == {c.label for c in cells[1:]}
    with pytest.raises(UnknownNameError, match="did you mean 'crashed'"):
        parse_retry(["crashd"])


def test_changed_data_and_code_are_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fake_plugin: Path
) -> None:
    store, cells = Store(tmp_path), [cell()]
    run(store, cells)
    monkeypatch.setenv("FAKE_DATA", "1" * 64)
    assert [r.reason for r in make_plan(cells, store).rows] == ["code, data, options or packages have changed"]
    run(store, cells)
    assert make_plan(cells, store).todo == []
    from panobench.bench.suite import fingerprint

    source = (fake_plugin / "fake_plugin.py").read_text()
    monkeypatch.setattr(fingerprint, "_source", lambda name: source + "#" if name == "fake_plugin" else None)
    fingerprint._imports.cache_clear()
    assert len(make_plan(cells, store).todo) == 1
    fingerprint._imports.cache_clear()
    assert len(list((tmp_path / "_superseded").iterdir())) == 1


def test_keys_depend_on_what_matters_and_on_nothing_else() -> None:
    planner = Planner()
    keys = {
        planner.plan(c).key
        for c in (
            cell(),
            cell(seed=1),
            cell(width=32),
            cell(holdout=2),
            cell("options"),
            cell("options", settings={"features": 7}),
            cell("options", preset="quick"),
        )
    }
    assert len(keys) == 7
    assert planner.plan(cell()).key == Planner().plan(cell(limits=Limits(timeout_s=1))).key


def test_impossible_cells_are_rows(tmp_path: Path) -> None:
    store = Store(tmp_path)
    cells = [cell("absent"), cell(camera="pal"), cell("inertial", sequence="a", dataset="synpano", root=str(tmp_path))]
    run(store, cells)
    assert statuses(store, cells) == ["unavailable", "unsupported", "unavailable"]
    message = read_run_json(store.folder(cells[0]))["message"]
    assert "no_such_package" in message
    assert message in (store.folder(cells[0]) / "log.txt").read_text()
    assert make_plan(cells, store).todo == []


def test_a_calibration_file_is_judged_for_each_method_by_itself(tmp_path: Path) -> None:
    camera = tmp_path / "narrow.yaml"
    camera.write_text("model: pinhole\nwidth: 64\nheight: 48\nfx: 40.0\nfy: 40.0\ncx: 32.0\ncy: 24.0\n")
    planner = Planner()
    found = [planner.plan(cell(method, camera=str(camera))) for method in ("options", "still", "options")]
    assert [p.status for p in found] == [RunStatus.UNSUPPORTED, None, RunStatus.UNSUPPORTED]
    assert "'fake-options' does not take pinhole images" in found[0].message


def test_a_sequence_that_was_not_downloaded_is_a_row_and_a_wrong_built_in_name_a_mistake(tmp_path: Path) -> None:
    import cv2
    import numpy as np

    folder = tmp_path / "data" / "here"
    (folder / "images").mkdir(parents=True)
    for number in range(2):
        cv2.imwrite(str(folder / "images" / f"{number}.png"), np.zeros((32, 64, 3), np.uint8))
    (folder / "camera.yaml").write_text("model: erp\nwidth: 64\nheight: 32\n")
    (folder / "frames.csv").write_text("time,file\n0.0,images/0.png\n0.1,images/1.png\n")
    data = {"dataset": "folder", "root": str(tmp_path / "data")}
    here, gone = (Planner().plan(cell(sequence=name, **data)) for name in ("here", "gone"))
    assert here.status is None
    assert gone.status is RunStatus.UNAVAILABLE
    assert "'gone'" in gone.message
    with pytest.raises(UnknownNameError, match="rom1"):
        Planner().plan(cell(dataset="rooms", sequence="rom1"))


def test_a_raised_limit_is_a_reason(tmp_path: Path) -> None:
    def times_out(planned: Planned, suite: str, place: Path, stopper: Stopper) -> Path:
        from panobench.bench.suite.failure import write_failure
        from panobench.bench.suite.runner import entry

        about = entry(planned, suite)
        return write_failure(place / "r", planned.cell.request, RunStatus.TIMEOUT, "slow", cell=about)

    store = Store(tmp_path)
    run(store, [cell(limits=Limits(timeout_s=5))], compute=times_out)
    assert make_plan([cell(limits=Limits(timeout_s=5))], store).todo == []
    assert make_plan([cell(limits=Limits(timeout_s=4))], store).todo == []
    assert make_plan([cell(limits=Limits(timeout_s=6))], store).todo[0].reason == "its limit timeout_s was raised"


def test_a_corrupted_result_is_quarantined_and_run_again(tmp_path: Path) -> None:
    store, cells = Store(tmp_path), [cell(), cell(seed=1)]
    run(store, cells)
    (store.folder(cells[0]) / "run.json").write_text('{"schema": 1, "status": "o')
    plan = make_plan(cells, store)
    assert [r.reason for r in plan.rows] == ["its stored result was damaged", ""]
    assert len(plan.quarantined) == 1
    assert "run.json:1: not valid JSON" in plan.quarantined[0].reason
    SuiteRunner(store, "test", Silent(), compute=quick).run(plan)
    assert statuses(store, cells) == ["ok", "ok"]
    assert [q.reason for q in store.quarantined()] == [plan.quarantined[0].reason]


def test_choosing_cells() -> None:
    cells = [cell(), cell("crash"), cell(seed=1)]
    assert choose(cells, []) == cells
    assert choose(cells, ["crash"]) == [cells[1]]
    assert choose(cells, ["fake-still*seed 1", "*crash*"]) == cells[1:]
    with pytest.raises(UnknownNameError, match="--only"):
        choose(cells, ["nothing"])


def test_a_lost_supervisor_is_not_the_methods_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from panobench.bench.suite import runner as suite

    attempts = []

    def flaky(planned: Any, about: CellRecord, place: Path, stopper: Stopper) -> Path:
        attempts.append(about.attempt)
        if len(attempts) < 3:
            raise InfrastructureError("gone")
        return run_isolated(planned, about, place, stopper)

    monkeypatch.setattr(suite, "run_isolated", flaky)
    store, cells = Store(tmp_path), [cell()]
    run(store, cells, compute=suite.compute)
    assert attempts == [1, 2, 3]
    assert statuses(store, cells) == ["ok"]
    attempts.clear()
    monkeypatch.setattr(suite, "run_isolated", lambda *a: (_ for _ in ()).throw(InfrastructureError("gone")))
    run(store, [cell(seed=9)], compute=suite.compute)
    found = read_run_json(store.folder(cell(seed=9)))
    assert (found["status"], found["message"]) == ("interrupted", "not run to its end: gone")
    assert make_plan([cell(seed=9)], store).todo[0].reason == "it was interrupted"

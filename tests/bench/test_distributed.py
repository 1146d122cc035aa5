"""Suites on dask: the same results as here, and a lost worker is not the method's failure."""

from __future__ import annotations

import io
import os
import signal
import tarfile
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.records.runfolder import read_run_json
from panobench.bench.run.request import RunRequest
from panobench.bench.suite.cells import Cell, Limits, Planned
from panobench.bench.suite.runner import SuiteRunner, compute, make_plan
from panobench.bench.suite.store import Store, Stored
from panobench.errors import InputError, UsageError

pytest.importorskip("distributed")
from panobench.bench.suite import distributed as module

pytestmark = pytest.mark.usefixtures("fake_plugin")


class Silent:
    def started(self, planned: Planned) -> None: ...

    def finished(self, planned: Planned, stored: Stored, note: str) -> None: ...


def cell(method: str, seed: int = 0) -> Cell:
    request = RunRequest(method=f"fake-{method}", dataset="tiny", sequence="blind", width=64, max_frames=6, seed=seed)
    return Cell(request, limits=Limits(timeout_s=300))


def plan_of(store: Store, cells: list[Cell]) -> Any:
    return make_plan(cells, store)


@pytest.mark.slow
def test_results_are_those_of_the_local_executor(tmp_path: Path) -> None:
    cells = [cell("still"), cell("exit"), cell("absent")]
    here, there = Store(tmp_path / "here"), Store(tmp_path / "there")
    SuiteRunner(here, "s", Silent(), compute=compute).run(plan_of(here, cells), 2)
    with module.DaskCompute(None, 2) as dask:
        SuiteRunner(there, "s", Silent(), compute=dask).run(plan_of(there, cells), dask.parallel)
    for c in cells:
        one, two = read_run_json(here.folder(c)), read_run_json(there.folder(c))
        for key in ("status", "message", "metrics", "spec", "keyframes", "cell", "frames"):
            assert one[key] == two[key], key
        for name in ("trajectory.tum",):
            assert (here.folder(c) / name).read_bytes() == (there.folder(c) / name).read_bytes()
        assert sorted(p.name for p in here.folder(c).rglob("*")) == sorted(p.name for p in there.folder(c).rglob("*"))
    assert [read_run_json(there.folder(c))["status"] for c in cells] == ["ok", "crashed", "unavailable"]


@pytest.mark.slow
def test_a_worker_killed_in_mid_run_is_an_infrastructure_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_SLEEP", "0.7")
    store, chosen = Store(tmp_path), cell("slow")
    with module.DaskCompute(None, 1) as dask:
        runner = SuiteRunner(store, "s", Silent(), compute=dask)
        thread = threading.Thread(target=runner.run, args=(plan_of(store, [chosen]), 1))
        thread.start()
        worker, supervisor = _wait_for_run(dask)
        os.kill(worker, signal.SIGKILL)
        deadline = time.monotonic() + 60
        while Path(f"/proc/{supervisor}").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not Path(f"/proc/{supervisor}").exists(), "the lost worker's run goes on"
        thread.join(300)
    found = read_run_json(store.folder(chosen))
    assert found["status"] == "ok"
    assert found["cell"]["attempt"] == 2


def _wait_for_run(dask: Any) -> tuple[int, int]:
    """Process ids of the worker and of the supervisor it started."""
    from panobench.bench.suite.process_tree import descendants

    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        for worker in dask.client.run(os.getpid).values():
            for pid in descendants(worker):
                try:
                    words = Path(f"/proc/{pid}/cmdline").read_bytes()
                except OSError:
                    continue
                if b"panobench.bench.suite.supervisor" in words and len(descendants(pid)) > 0:
                    return worker, pid
        time.sleep(0.05)
    raise AssertionError("no run was started")


@pytest.mark.slow
def test_stopping_ends_the_runs_of_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_SLEEP", "60")
    store, chosen = Store(tmp_path), cell("slow")
    with module.DaskCompute(None, 1) as dask:
        runner = SuiteRunner(store, "s", Silent(), compute=dask)
        thread = threading.Thread(target=runner.run, args=(plan_of(store, [chosen]), 1))
        thread.start()
        _, supervisor = _wait_for_run(dask)
        runner.stopper.stop()
        thread.join(60)
        assert read_run_json(store.folder(chosen))["status"] == "interrupted"
        deadline = time.monotonic() + 60
        while Path(f"/proc/{supervisor}").exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not Path(f"/proc/{supervisor}").exists()


def test_a_worker_with_other_code_is_refused() -> None:
    with pytest.raises(UsageError, match="its code, packages or data differ"):
        module.run_remotely(cell("still").to_dict(), "another key", {})


def test_a_scheduler_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONNECT_S", 1.0)
    with pytest.raises(UsageError, match=r"--scheduler tcp://127\.0\.0\.1:1: cannot be reached"):
        module.DaskCompute("tcp://127.0.0.1:1", 1)


def test_archives_travel_whole_and_hostile_ones_are_refused(tmp_path: Path) -> None:
    (tmp_path / "run" / "renders").mkdir(parents=True)
    (tmp_path / "run" / "renders" / "a.jpg").write_bytes(b"123")
    (tmp_path / "place").mkdir()
    folder = module.unpack(module.pack(tmp_path / "run"), tmp_path / "place")
    assert (folder / "renders" / "a.jpg").read_bytes() == b"123"
    for name, kind in (("run/../../evil", tarfile.REGTYPE), ("/run/x", tarfile.REGTYPE), ("run/link", tarfile.SYMTYPE)):
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w") as archive:
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            archive.addfile(member)
        with pytest.raises(InputError, match="entry"):
            module.unpack(buffer.getvalue(), tmp_path / "place")
    with pytest.raises(InputError, match="no archive"):
        module.unpack(b"nonsense", tmp_path / "place")

"""Runs in processes of their own: limits, crashes, and children that outlive them."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from suite_runs import cell, processes, run, statuses

from panobench.bench.records.record import CellRecord
from panobench.bench.records.runfolder import read_run_json
from panobench.bench.suite import isolated
from panobench.bench.suite.cells import Limits
from panobench.bench.suite.isolated import InfrastructureError, Stopper, judge, run_isolated
from panobench.bench.suite.store import Store
from panobench.bench.suite.supervisor import Result

pytestmark = pytest.mark.usefixtures("fake_plugin")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "limits", "status", "says"),
    [
        ("still", {}, "ok", ""),
        ("exit", {}, "crashed", "ended by itself with exit code 7"),
        ("segfault", {}, "crashed", "died by signal 11 (SIGSEGV)"),
        ("hungry", {"memory_gib": 0.6}, "out-of-memory", "more than 0.6 GiB"),
        ("hang", {"timeout_s": 8.0}, "timeout", "killed after 8 s"),
        ("crash", {}, "crashed", "frame 3: ValueError: three is my limit"),
        ("still-broken", {}, "unavailable", "frame 5: the image is truncated"),
    ],
)
def test_isolation(tmp_path: Path, method: str, limits: dict[str, float], status: str, says: str) -> None:
    """Each ends its own run alone, and is a row with the reason and the log's tail."""
    method, _, sequence = method.partition("-")
    chosen = cell(method, sequence=sequence or "blind", max_frames=8, limits=Limits(**{"timeout_s": 300.0, **limits}))
    (tmp_path / "place").mkdir()
    folder = run_isolated(chosen, CellRecord(key="k"), tmp_path / "place")
    document = read_run_json(folder)
    assert document["status"] == status
    assert says in document["message"]
    assert document["cell"]["key"] == "k"
    assert document["isolation"]["peak_rss_bytes"] > 20 << 20
    log = (folder / "log.txt").read_text()
    assert status in log
    if method == "segfault":
        assert "fake_plugin.py" in log  # where it happened
    if status == "timeout":
        assert document["timing"]["wall_s"] >= 8.0


@pytest.mark.slow
def test_a_fork_bomb_ends_its_cell_alone_and_leaves_no_orphan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PIDS", str(tmp_path / "pids"))
    store = Store(tmp_path / "store")
    cells = [cell("bomb", limits=Limits(timeout_s=300, processes=25)), cell()]
    from panobench.bench.suite.runner import compute

    run(store, cells, compute=compute)
    assert statuses(store, cells) == ["crashed", "ok"]
    document = read_run_json(store.folder(cells[0]))
    assert document["message"] == "killed when it had more than 25 processes"
    assert document["isolation"]["peak_processes"] > 25
    pids = (tmp_path / "pids").read_text().split()
    assert len(pids) > 3
    assert not [p for p in pids if Path(f"/proc/{p}").exists()]


@pytest.mark.parametrize(
    ("result", "status", "says"),
    [
        (Result("timeout"), "timeout", "after 3 s"),
        (Result("out-of-memory"), "out-of-memory", "more than 2 GiB"),
        (Result("processes"), "crashed", "more than 9 processes"),
        (Result("output"), "crashed", "printed more than 256 MiB"),
        (Result("stopped"), "interrupted", "interrupted"),
        (Result(returncode=-9, oom_kill=True), "out-of-memory", "by the system"),
        (Result(returncode=-9), "crashed", "signal 9 (SIGKILL)"),
        (Result(returncode=-63), "crashed", "signal 63"),
        (Result(returncode=3), "crashed", "exit code 3"),
        (Result(returncode=0), "crashed", "before the run was complete"),
    ],
)
def test_how_a_run_without_a_folder_is_judged(result: Result, status: str, says: str) -> None:
    found, message = judge(result, cell(limits=Limits(timeout_s=3, memory_gib=2, processes=9)))
    assert found.value == status
    assert says in message


def test_a_methods_own_memory_error_is_out_of_memory(tmp_path: Path) -> None:
    store, cells = Store(tmp_path), [cell("exhausted"), cell()]
    run(store, cells)
    assert statuses(store, cells) == ["out-of-memory", "ok"]
    assert read_run_json(store.folder(cells[0]))["message"].startswith("frame 2: MemoryError")


@pytest.mark.slow
def test_children_of_a_killed_run_are_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PIDS", str(tmp_path / "pids"))
    monkeypatch.setattr(isolated, "GRACE_S", 6.0)
    (tmp_path / "place").mkdir()
    stopper = Stopper()
    found: list[Path] = []
    thread = threading.Thread(
        target=lambda: found.append(run_isolated(cell("spawner"), CellRecord(), tmp_path / "place", stopper))
    )
    thread.start()
    deadline = time.monotonic() + 120
    while words_of(tmp_path / "pids") != 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    pids = [int(p) for p in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 3
    stopper.stop()
    thread.join(120)
    assert read_run_json(found[0])["status"] == "interrupted"
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{p}").exists() for p in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [p for p in pids if Path(f"/proc/{p}").exists()]


@pytest.mark.slow
def test_children_are_gone_too_when_their_supervisor_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PIDS", str(tmp_path / "pids"))
    (tmp_path / "place").mkdir()
    found: list[Exception] = []

    def go() -> None:
        try:
            run_isolated(cell("spawner"), CellRecord(), tmp_path / "place")
        except InfrastructureError as error:
            found.append(error)

    thread = threading.Thread(target=go)
    thread.start()
    deadline = time.monotonic() + 120
    while words_of(tmp_path / "pids") != 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    pids = [int(p) for p in (tmp_path / "pids").read_text().split()]
    supervisors = processes(tmp_path / "place", b"panobench.bench.suite.supervisor")
    assert len(supervisors) == 1
    os.kill(int(supervisors[0]), signal.SIGKILL)
    thread.join(120)
    assert "ended without a result (-9)" in str(found[0])
    deadline = time.monotonic() + 60
    while any(alive(p) for p in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [p for p in pids if alive(p)]


def alive(pid: int) -> bool:
    """Neither gone nor a zombie that nobody here can wait for."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def words_of(path: Path) -> int:
    return len(path.read_text().split()) if path.exists() else 0

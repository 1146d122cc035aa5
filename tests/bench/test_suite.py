"""Suites: what runs, what stands, what is amended; with real processes for what kills them."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from panobench.bench import isolated
from panobench.bench.cells import Cell, Limits, Planned, Planner
from panobench.bench.isolated import InfrastructureError, Stopper, judge, run_isolated
from panobench.bench.request import RunRequest
from panobench.bench.runfolder import read_run_json
from panobench.bench.store import Store, Stored
from panobench.bench.suite import SuiteRunner, choose, make_plan, parse_retry
from panobench.bench.supervisor import Result
from panobench.errors import OutputError, UnknownNameError
from panobench.types import RunStatus

pytestmark = pytest.mark.usefixtures("fake_plugin")


class Silent:
    def __init__(self) -> None:
        self.notes: list[tuple[str, str]] = []

    def started(self, planned: Planned) -> None:
        self.notes.append(("started", planned.cell.label))

    def finished(self, planned: Planned, stored: Stored, note: str) -> None:
        self.notes.append((stored.status, planned.cell.label))


def cell(method: str = "still", seed: int = 0, **options: Any) -> Cell:
    limits = options.pop("limits", Limits(timeout_s=300))
    values: dict[str, Any] = {"dataset": "tiny", "sequence": "blind", "width": 64, "max_frames": 4, **options}
    return Cell(RunRequest(method=f"fake-{method}", seed=seed, **values), limits=limits)


def quick(planned: Planned, suite: str, place: Path, stopper: Stopper) -> Path:
    """The run in this process: for tests of everything around it."""
    from panobench.bench.runner import execute
    from panobench.bench.suite import entry

    if planned.status is not None:
        from panobench.bench.suite import compute

        return compute(planned, suite, place, stopper)
    return execute(planned.cell.request, place / "run", extra={"cell": entry(planned, suite)})


def run(store: Store, cells: list[Cell], retry: str = "", compute: Any = quick, jobs: int = 1) -> Silent:
    watcher = Silent()
    plan = make_plan(cells, store, parse_retry([retry] if retry else []))
    SuiteRunner(store, "test", watcher, compute=compute).run(plan, jobs)
    return watcher


def statuses(store: Store, cells: list[Cell]) -> list[str]:
    found = [store.find(c) for c in cells]
    return [f.status if f else "" for f in found]


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
    from panobench.bench import fingerprint

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
        from panobench.bench.failure import write_failure
        from panobench.bench.suite import entry

        about = {"cell": entry(planned, suite)}
        return write_failure(place / "r", planned.cell.request, RunStatus.TIMEOUT, "slow", extra=about)

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
    from panobench.bench import suite

    attempts = []

    def flaky(planned: Any, about: dict[str, Any], place: Path, stopper: Stopper) -> Path:
        attempts.append(about["attempt"])
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
    folder = run_isolated(chosen, {"key": "k"}, tmp_path / "place")
    document = read_run_json(folder)
    assert document["status"] == status
    assert says in document["message"]
    assert document["cell"] == {"key": "k"}
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
    from panobench.bench.suite import compute

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
        target=lambda: found.append(run_isolated(cell("spawner"), {}, tmp_path / "place", stopper))
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
            run_isolated(cell("spawner"), {}, tmp_path / "place")
        except InfrastructureError as error:
            found.append(error)

    thread = threading.Thread(target=go)
    thread.start()
    deadline = time.monotonic() + 120
    while words_of(tmp_path / "pids") != 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    pids = [int(p) for p in (tmp_path / "pids").read_text().split()]
    supervisors = processes(tmp_path / "place", b"panobench.bench.supervisor")
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


SUITE = """
methods: [fake-slow]
datasets: [{{name: tiny, sequences: [blind]}}]
seeds: {seeds}
options: {{width: 64, max_frames: 6, timeout_s: 300}}
"""


def command(tmp_path: Path, *extra: str, cells: int = 6) -> list[str]:
    (tmp_path / "suite.yaml").write_text(SUITE.format(seeds=list(range(cells))))
    base = [sys.executable, "-m", "panobench.cli.main", "suite", "run", str(tmp_path / "suite.yaml")]
    return [*base, "--out", str(tmp_path / "store"), *extra]


def finished(tmp_path: Path) -> dict[str, tuple[int, str]]:
    """Result folders and what tells one result from another."""
    found = {}
    for folder in (tmp_path / "store" / "runs").glob("*"):
        document = read_run_json(folder)  # raises when damaged: "there whole or not at all"
        found[folder.name] = ((folder / "run.json").stat().st_ino, document["status"])
    return found


def workers_of(tmp_path: Path) -> list[str]:
    """Processes that work for this store."""
    return processes(tmp_path / "store", b"panobench.bench")


def processes(place: Path, module: bytes) -> list[str]:
    """Ids of processes whose command line names a path below ``place``, and a Python module."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if any(str(place).encode() in w for w in words) and module in b" ".join(words):
            found.append(path.parent.name)
    return found


def none_left(tmp_path: Path) -> bool:
    deadline = time.monotonic() + 60
    while workers_of(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.1)
    return workers_of(tmp_path) == []


@pytest.mark.slow
def test_kill_9_at_twenty_random_moments(tmp_path: Path) -> None:
    """Every finished result stays as it is, none is counted twice, no cell is lost, no process is left."""
    rng = random.Random(0)
    env = {**os.environ, "FAKE_SLEEP": "0.02"}
    kills, seen, lasted = 0, {}, 4.0
    store = tmp_path / "store"
    while kills < 20:
        begin = time.monotonic()
        words = command(tmp_path, "--quiet", "--jobs", "2", cells=4)
        process = subprocess.Popen(words, env=env, stderr=subprocess.DEVNULL)
        try:
            process.wait(rng.uniform(0.1, 1.1) * lasted)
            # it went through before it could be killed: take some results away and go on killing
            lasted = time.monotonic() - begin
            now = finished(tmp_path)
            assert {k: now.get(k) for k in seen} == seen, "a finished result was lost or made again"
            victims = rng.sample(sorted(now), 3)
            for name in victims:
                (store / "runs" / name).rename(tmp_path / f"gone-{begin}-{name}")
            seen = finished(tmp_path)
            continue
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills += 1
        now = finished(tmp_path) if (store / "runs").is_dir() else {}
        assert {k: now.get(k) for k in seen} == seen, "a finished result was lost or made again"
        assert all(status == "ok" for _, status in now.values())
        seen = now
    assert none_left(tmp_path)
    done = subprocess.run(command(tmp_path, "--json", cells=4), env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [r["status"] for r in rows] == ["ok"] * 4
    end = finished(tmp_path)
    assert len(end) == 4
    assert {k: end[k] for k in seen} == seen
    assert list((store / ".work").iterdir()) == []
    assert not (store / "_quarantine").exists()


@pytest.mark.slow
def test_two_suites_on_one_store(tmp_path: Path) -> None:
    """They share the work; each cell is run once, and both see all results."""
    env = {**os.environ, "FAKE_SLEEP": "0.05"}
    both = [
        subprocess.Popen(command(tmp_path), env=env, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    outputs = [p.communicate(timeout=500) for p in both]
    assert [p.returncode for p in both] == [0, 0], outputs
    assert len(finished(tmp_path)) == 6
    assert all(out.startswith("6 ok") for out, _ in outputs)
    assert not (tmp_path / "store" / "_superseded").exists(), "a cell was run twice"


@pytest.mark.slow
def test_ctrl_c_of_a_suite_keeps_what_is_done(tmp_path: Path) -> None:
    process = subprocess.Popen(
        command(tmp_path),
        env={**os.environ, "FAKE_SLEEP": "0.8"},
        stderr=subprocess.PIPE,
        text=True,
        # a shell's background jobs ignore it, and so would what they start
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stderr is not None
    assert process.stderr.readline().startswith("[1/6] ok")
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    found = [status for _, status in finished(tmp_path).values()]
    assert "ok" in found
    assert set(found) <= {"ok", "interrupted"}
    assert none_left(tmp_path)


@pytest.mark.slow
def test_a_full_disk_stops_the_suite_and_harms_nothing(small_disk: Any) -> None:
    from panobench.bench.suite import compute

    store, first, second = Store(small_disk.path / "s"), cell(), cell(seed=1)
    run(store, [first], compute=compute)
    before = (store.folder(first) / "run.json").read_bytes()
    filler = small_disk.leave(6)  # room to begin, not to end
    with pytest.raises(OutputError, match="the disk is full; free some space and run the same command again"):
        run(store, [first, second], compute=compute)
    assert (store.folder(first) / "run.json").read_bytes() == before
    assert store.find(second) is None
    filler.unlink()
    run(store, [first, second], compute=compute)
    assert statuses(store, [first, second]) == ["ok", "ok"]
    assert (store.folder(first) / "run.json").read_bytes() == before

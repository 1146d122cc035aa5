"""Suites that are killed, interrupted, run twice at once, or run out of disk."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from suite_runs import cell, processes, run, statuses

from panobench.bench.records.runfolder import read_run_json
from panobench.bench.suite.store import Store
from panobench.errors import OutputError

pytestmark = pytest.mark.usefixtures("fake_plugin")


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


def none_left(tmp_path: Path) -> bool:
    deadline = time.monotonic() + 60
    while workers_of(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.1)
    return workers_of(tmp_path) == []


@pytest.mark.slow
def test_kill_9_at_twelve_random_moments(tmp_path: Path) -> None:
    """Every finished result stays as it is, none is counted twice, no cell is lost, no process is left."""
    rng = random.Random(0)
    env = {**os.environ, "FAKE_SLEEP": "0.02"}
    kills, seen, lasted = 0, {}, 4.0
    store = tmp_path / "store"
    while kills < 12:
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
    from panobench.bench.suite.runner import compute

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

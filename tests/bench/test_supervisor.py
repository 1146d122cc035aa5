"""Limits hold and nothing is left behind, whatever the command does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.suite.supervisor import gpu_bytes

MIB = 1 << 20
#: Starts a child in its group, one in a new session, and one through a double fork; writes their ids.
SPAWN = """
import os, subprocess, sys, time
sleep = [sys.executable, "-c", "import time; time.sleep(300)"]
pids = [subprocess.Popen(sleep).pid, subprocess.Popen(sleep, start_new_session=True).pid]
r, w = os.pipe()
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        os.write(w, str(os.getpid()).encode())
        os.close(w)
        time.sleep(300)
    os._exit(0)
pids.append(int(os.read(r, 100)))
open(sys.argv[1], "w").write(" ".join(map(str, pids)))
"""
#: Runs some code in several children and waits for them.
CHILDREN = """
import subprocess, sys
for child in [subprocess.Popen([sys.executable, "-c", sys.argv[1]]) for _ in range(int(sys.argv[2]))]:
    child.wait()
"""


def write_job(tmp_path: Path, code: str, *arguments: str, parent: int | None = None, **limits: Any) -> Path:
    job = {
        "argv": [sys.executable, "-c", code, *arguments],
        "output": str(tmp_path / "output"),
        "result": str(tmp_path / "result.json"),
        "timeout_s": 100.0,
        "memory_bytes": 1 << 40,
        "processes": 100,
        "grace_s": 0.5,
        "parent": parent or os.getpid(),
        **limits,
    }
    path = tmp_path / "job.json"
    path.write_text(json.dumps(job))
    return path


def start(job: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "panobench.bench.suite.supervisor", str(job)])


def supervise(tmp_path: Path, code: str, *arguments: str, **limits: Any) -> dict[str, Any]:
    assert start(write_job(tmp_path, code, *arguments, **limits)).wait(120) == 0
    result: dict[str, Any] = json.loads((tmp_path / "result.json").read_text())
    return result


def wait_for(path: Path) -> list[int]:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if path.exists() and len(path.read_text().split()) == 3:
            return [int(p) for p in path.read_text().split()]
        time.sleep(0.05)
    raise AssertionError("the command did not start its children")


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def assert_gone(pids: list[int]) -> None:
    deadline = time.monotonic() + 20
    while any(alive(p) for p in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [p for p in pids if alive(p)]


@pytest.mark.parametrize(
    ("code", "returncode"),
    [
        ("print('said')", 0),
        ("import os; os._exit(7)", 7),
        ("import os; os.kill(os.getpid(), 11)", -signal.SIGSEGV),
        ("import os; os.kill(os.getpid(), 9)", -signal.SIGKILL),
    ],
)
def test_ends_of_the_command_are_reported(tmp_path: Path, code: str, returncode: int) -> None:
    result = supervise(tmp_path, code)
    assert (result["end"], result["returncode"]) == ("exit", returncode)
    assert result["oom_kill"] is False
    if returncode == 0:
        assert (tmp_path / "output").read_text() == "said\n"


def test_usage_is_that_of_the_whole_tree(tmp_path: Path) -> None:
    busy = "b = bytearray(b'x') * (100 << 20); import time\nwhile time.process_time() < 0.5: pass\ntime.sleep(0.3)"
    result = supervise(tmp_path, CHILDREN, busy, "2")
    assert result["peak_processes"] == 3
    assert result["peak_rss_bytes"] > 200 * MIB
    assert result["cpu_s"] > 0.9
    assert result["peak_gpu_bytes"] is None or result["peak_gpu_bytes"] >= 0


def test_timeout_kills_even_what_ignores_signals(tmp_path: Path) -> None:
    code = (
        "import signal, time\n"
        "for s in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP): signal.signal(s, signal.SIG_IGN)\n"
        "while True: time.sleep(1)"
    )
    result = supervise(tmp_path, code, timeout_s=1.0)
    assert result["end"] == "timeout"
    assert 1.0 <= result["wall_s"] < 100


def test_memory_limit_counts_children(tmp_path: Path) -> None:
    child = "b = bytearray(b'x') * (80 << 20); import time; time.sleep(60)"
    result = supervise(tmp_path, CHILDREN, child, "3", memory_bytes=200 * MIB)
    assert result["end"] == "out-of-memory"
    assert result["peak_rss_bytes"] > 200 * MIB


def test_a_fork_bomb_ends(tmp_path: Path) -> None:
    code = "import os, time\nfor _ in range(7): os.fork()\ntime.sleep(300)"
    result = supervise(tmp_path, code, processes=40)
    assert result["end"] == "processes"
    assert result["peak_processes"] > 40


def test_a_flood_of_output_ends(tmp_path: Path) -> None:
    code = "import sys\nwhile True: sys.stdout.write('x' * 100_000)"
    result = supervise(tmp_path, code, output_bytes=5 * MIB)
    assert result["end"] == "output"
    assert (tmp_path / "output").stat().st_size > 5 * MIB
    (tmp_path / "output").unlink()
    quiet = supervise(tmp_path, "print('x' * 1000)", output_bytes=5 * MIB)
    assert (quiet["end"], quiet["returncode"]) == ("exit", 0)


def test_nothing_survives_the_end_of_the_command(tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    result = supervise(tmp_path, SPAWN, str(pids))
    assert result["end"] == "exit"
    assert_gone(wait_for(pids))


def test_nothing_survives_a_timeout(tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    process = start(write_job(tmp_path, SPAWN + "time.sleep(300)", str(pids), timeout_s=8.0))
    found = wait_for(pids)
    assert process.wait(60) == 0
    assert json.loads((tmp_path / "result.json").read_text())["end"] == "timeout"
    assert_gone(found)


def test_asked_to_stop_it_lets_the_command_finish_first(tmp_path: Path) -> None:
    code = (
        "import time\ntry:\n    open('ready', 'w').close()\n    time.sleep(300)\n"
        "except KeyboardInterrupt:\n    open('saved', 'w').close()"
    )
    process = start(write_job(tmp_path, code, cwd=str(tmp_path), grace_s=30.0))
    deadline = time.monotonic() + 60
    while not (tmp_path / "ready").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    assert json.loads((tmp_path / "result.json").read_text())["end"] == "stopped"
    assert (tmp_path / "saved").exists()


def test_everything_dies_with_the_process_that_asked_for_it(tmp_path: Path) -> None:
    """As when a suite is killed with -9: no supervisor, no command, no child stays."""
    pids = tmp_path / "pids"
    starter = (
        "import json, os, subprocess, sys, time\n"
        "job = json.load(open(sys.argv[1])); job['parent'] = os.getpid(); json.dump(job, open(sys.argv[1], 'w'))\n"
        "subprocess.Popen([sys.executable, '-m', 'panobench.bench.suite.supervisor', sys.argv[1]])\n"
        "time.sleep(300)"
    )
    job = write_job(tmp_path, SPAWN + "time.sleep(300)", str(pids))
    parent = subprocess.Popen([sys.executable, "-c", starter, str(job)])
    found = wait_for(pids)
    parent.kill()
    parent.wait()
    assert_gone(found)


def test_a_supervisor_whose_parent_is_gone_does_not_start(tmp_path: Path) -> None:
    code = f"open({str(tmp_path / 'ran')!r}, 'w')"
    assert start(write_job(tmp_path, code, parent=1)).wait(60) == 0
    assert not (tmp_path / "ran").exists()


def test_gpu_memory_is_summed_over_our_processes() -> None:
    table = "101, 512\n102, 64\n999, 4096\n[N/A], 3\n103, [N/A]\n"
    assert gpu_bytes(table, {101, 102, 103}) == 576 * MIB
    assert gpu_bytes("", {1}) == 0

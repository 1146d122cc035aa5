"""Run one command with limits and leave no process of it behind.

Its command is ``python -m panobench.bench.suite.supervisor JOB.json``.

The supervisor is the "child subreaper" of all that the command starts, so that descendants which detach (new
sessions, double forks) stay its own and are found and killed. It kills everything and ends when its parent dies.
Only the standard library is imported: it must be small and quick to start.

JOB.json: argv, cwd, output (file), result (file), timeout_s, memory_bytes, processes, output_bytes, grace_s.
The result file: end ("exit", "timeout", "out-of-memory", "processes", "output" or "stopped"), returncode
(negative: signal), oom_kill (the kernel killed for lack of memory meanwhile), wall_s, cpu_s, peak_rss_bytes,
peak_processes, peak_gpu_bytes.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from panobench.bench.suite.process_tree import descendants, resident_bytes

PERIOD_S = 0.05
_GPU_PERIOD_S = 2.0
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36


@dataclass
class Result:
    """How a command ended and what it used."""

    end: str = "exit"
    returncode: int | None = None
    oom_kill: bool = False
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_rss_bytes: int = 0
    peak_processes: int = 0
    peak_gpu_bytes: int | None = None


class Stopped(Exception):
    """The parent asked to stop, or died."""


def supervise(job: dict[str, Any]) -> Result:
    """Run ``job`` to its end. No process that it started is alive afterwards."""
    result = Result()
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    kills = _oom_kills()
    begin = time.monotonic()
    with open(job["output"], "ab") as output:
        child = subprocess.Popen(
            job["argv"],
            cwd=job.get("cwd"),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=_in_child,
        )
        try:
            _watch(child, job, result, begin)
        except Stopped:
            result.end = "stopped"
            _ask_to_stop(child, float(job.get("grace_s", 5.0)))
        finally:
            # ignore signals from here to the end
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
            kill_descendants()
    if result.returncode is None:
        result.returncode = child.returncode
    result.oom_kill = _oom_kills() > kills
    result.wall_s = time.monotonic() - begin
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    result.cpu_s = usage.ru_utime + usage.ru_stime
    return result


def _in_child() -> None:
    """Prepare the command's process, before the command starts: the kernel kills it first when memory is short."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("1000")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _watch(child: subprocess.Popen[bytes], job: dict[str, Any], result: Result, begin: float) -> None:
    parent = os.getppid()
    next_gpu = begin
    while True:
        result.returncode = child.poll()
        if result.returncode is not None:
            return
        rss, count = _tree_usage()
        result.peak_rss_bytes = max(result.peak_rss_bytes, rss)
        result.peak_processes = max(result.peak_processes, count)
        now = time.monotonic()
        if now >= next_gpu and _has_gpu():
            used = gpu_bytes(_nvidia_smi(), set(descendants(os.getpid())))
            result.peak_gpu_bytes = max(result.peak_gpu_bytes or 0, used)
            next_gpu = now + _GPU_PERIOD_S
        if now - begin > job["timeout_s"]:
            result.end = "timeout"
        elif rss > job["memory_bytes"]:
            result.end = "out-of-memory"
        elif count > job["processes"]:
            result.end = "processes"
        elif "output_bytes" in job and _size(job["output"]) > job["output_bytes"]:
            result.end = "output"
        if result.end != "exit":
            return
        if os.getppid() != parent:
            raise Stopped
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(PERIOD_S)


def _size(path: str) -> int:
    try:
        return os.stat(path).st_size
    except OSError:
        return 0


def _ask_to_stop(child: subprocess.Popen[bytes], grace_s: float) -> None:
    """Send Ctrl-C to the command, twice if need be, so that it can write what it has."""
    for _ in range(2):
        with contextlib.suppress(subprocess.TimeoutExpired, Stopped):
            child.send_signal(signal.SIGINT)
            child.wait(grace_s / 2)
            return


def kill_descendants() -> None:
    """Stop all descendants first, so that none can fork on, then kill and reap them until there are none."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for pid in descendants(os.getpid()):
                with contextlib.suppress(OSError):
                    os.kill(pid, number)
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
            time.sleep(0.01)
        except ChildProcessError:
            return


def _tree_usage() -> tuple[int, int]:
    """Resident bytes and number of the descendants."""
    below = descendants(os.getpid())
    return sum(map(resident_bytes, below)), len(below)


def _prctl(option: int, value: int) -> None:
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def _oom_kills() -> int:
    """How often the kernel killed for lack of memory since it started."""
    with contextlib.suppress(OSError), open("/proc/vmstat") as file:
        for line in file:
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    return 0


def _has_gpu() -> bool:
    return os.path.isdir("/proc/driver/nvidia/gpus")


def _nvidia_smi() -> str:
    command = ["nvidia-smi", "--query-compute-apps=pid,used_memory", "--format=csv,noheader,nounits"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5).stdout
    except (OSError, subprocess.SubprocessError):
        return ""


def gpu_bytes(table: str, pids: set[int]) -> int:
    """GPU memory of the processes, from nvidia-smi's "pid, MiB" lines."""
    total = 0
    for line in table.splitlines():
        pid, _, amount = line.partition(",")
        if pid.strip().isdigit() and amount.strip().isdigit() and int(pid) in pids:
            total += int(amount) << 20
    return total


def _stop(number: int, frame: Any) -> None:
    raise Stopped


def main() -> None:
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _stop)
    # the parent may have died before this line
    _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != job["parent"]:
        return
    try:
        result = supervise(job)
    except Stopped:  # it came before the command was started
        result = Result(end="stopped")
    target = Path(job["result"])
    part = target.with_suffix(".part")
    part.write_text(json.dumps(asdict(result)), encoding="utf-8")
    part.rename(target)


if __name__ == "__main__":
    main()

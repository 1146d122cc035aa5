"""Run a cell in a process of its own, with limits: whatever the method does, it ends that run alone."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from panobench.bench.records.record import CellRecord, TimingRecord, read_record, replace_record
from panobench.bench.records.runfolder import LOG, RUN_JSON
from panobench.bench.suite.cells import Cell
from panobench.bench.suite.failure import tail, write_failure
from panobench.bench.suite.supervisor import Result
from panobench.bench.suite.worker import DISK_FULL
from panobench.errors import InputError, OutputError, PanobenchError
from panobench.types import RunStatus
from panobench.writing import TEXT, disk_full, writing

#: Seconds a run has to write what it tracked when the suite is interrupted.
GRACE_S = 20.0
#: A run that prints more is ended before it fills the disk.
MAX_OUTPUT_BYTES = 256 << 20
#: The environment variable by which all processes of a run are known; its value is the folder the run works in.
MARK = "PANOBENCH_RUN_PLACE"


class InfrastructureError(PanobenchError):
    """The process that watched over a run was lost; the method is not to blame."""


class Interrupted(Exception):
    """A run was stopped before it wrote anything."""


class Stopper:
    """Lets another thread stop the runs that are going on."""

    def __init__(self) -> None:
        self._actions: list[Callable[[], object]] = []
        self.requested = False

    def stop(self) -> None:
        self.requested = True
        for action in list(self._actions):
            action()

    @contextlib.contextmanager
    def watching(self, action: Callable[[], object]) -> Iterator[None]:
        """A context in which ``stop`` calls ``action``, which stops the run that the block waits for."""
        self._actions.append(action)
        if self.requested:
            action()
        try:
            yield
        finally:
            self._actions.remove(action)


def run_isolated(cell: Cell, entry: CellRecord, place: Path, stopper: Stopper | None = None) -> Path:
    """Run a cell in an empty folder ``place`` and return the run folder below it; ``entry`` goes into its record.

    Raises OutputError when the disk is full, InfrastructureError when the supervisor was lost.
    """
    stopper = stopper or Stopper()
    out, job, supervised = place / "run", place / "cell.json", place / "job.json"
    with writing(place):
        job.write_text(json.dumps({"cell": cell.to_dict(), "entry": entry.to_dict()}), encoding="utf-8")
        supervised.write_text(
            json.dumps(
                {
                    "argv": [sys.executable, "-m", "panobench.bench.suite.worker", str(job), str(out)],
                    "output": str(place / "output.txt"),
                    "result": str(place / "result.json"),
                    "timeout_s": cell.limits.timeout_s,
                    "memory_bytes": cell.limits.memory_bytes,
                    "processes": cell.limits.processes,
                    "output_bytes": MAX_OUTPUT_BYTES,
                    "grace_s": GRACE_S,
                    "parent": os.getpid(),
                }
            ),
            encoding="utf-8",
        )
        process = subprocess.Popen(
            [sys.executable, "-m", "panobench.bench.suite.supervisor", str(supervised)],
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, MARK: str(place)},
        )
    with stopper.watching(process.terminate):
        process.wait()
    result = _read_result(place / "result.json")
    if result is None:
        kill_marked(str(place))
        raise InfrastructureError(f"the supervisor of '{cell.label}' ended without a result ({process.returncode})")
    if result.returncode == DISK_FULL:
        raise disk_full(place)
    return _finish(cell, entry, place, out, result)


def kill_marked(place: str) -> None:
    """Kill what a run started, when the supervisor that should have done so was killed itself."""
    mark = os.fsencode(f"{MARK}={place}")
    for _ in range(3):  # a process that is just being started may be missed once
        for environment in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                if mark in environment.read_bytes().split(b"\0"):
                    os.kill(int(environment.parent.name), signal.SIGKILL)


def _read_result(path: Path) -> Result | None:
    try:
        return Result(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _finish(cell: Cell, entry: CellRecord, place: Path, out: Path, result: Result) -> Path:
    """Complete the run folder the worker left, or make one that says why there is none."""
    output = tail(place / "output.txt")
    metering = {k: v for k, v in asdict(result).items() if k not in ("end", "returncode", "oom_kill")}
    whole = result.end in ("exit", "stopped") and (out / RUN_JSON).is_file()
    if whole:
        try:
            record = read_record(out)
        except InputError as error:
            raise OutputError(f"{place}: what was written there cannot be read again ({error})") from error
        record.isolation = metering
        with writing(place):
            replace_record(out, record)
            if output.strip():
                with (out / LOG).open("a", **TEXT) as log:
                    log.write("--- output of the process ---\n" + output)
        return out
    status, message = judge(result, cell)
    part = next(place.glob(".run.*.part"), None)
    log_text = "\n".join(t for t in (tail(part / LOG) if part else "", output) if t.strip())
    timing = TimingRecord(wall_s=result.wall_s, peak_rss_bytes=result.peak_rss_bytes or None, cpu_s=result.cpu_s)
    shutil.rmtree(out, ignore_errors=True)
    return write_failure(
        out, cell.request, status, message, log=log_text, timing=timing, cell=entry, isolation=metering
    )


def judge(result: Result, cell: Cell) -> tuple[RunStatus, str]:
    """Status and message of a run that wrote no folder."""
    limits = cell.limits
    if result.end == "timeout":
        return RunStatus.TIMEOUT, f"killed after {limits.timeout_s:g} s of wall-clock time"
    if result.end == "out-of-memory":
        return RunStatus.OUT_OF_MEMORY, f"killed when its processes held more than {limits.memory_gib:g} GiB"
    if result.end == "processes":
        return RunStatus.CRASHED, f"killed when it had more than {limits.processes:g} processes"
    if result.end == "output":
        return RunStatus.CRASHED, f"killed when it had printed more than {MAX_OUTPUT_BYTES >> 20} MiB"
    if result.end == "stopped":
        return RunStatus.INTERRUPTED, "interrupted"
    code = result.returncode or 0
    if code == -signal.SIGKILL and result.oom_kill:
        return RunStatus.OUT_OF_MEMORY, "killed by the system, which was out of memory"
    if code < 0:
        return RunStatus.CRASHED, f"its process died by signal {-code} ({_signal_name(-code)})"
    return RunStatus.CRASHED, f"its process ended by itself with exit code {code}, before the run was complete"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return "unknown"

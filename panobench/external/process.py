"""Running a program: without a shell, in its own process group, with a clean environment, a time limit and a log."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil

#: Environment variables that are passed on if they are set, beside those that a job or the user names.
ENVIRONMENT = (
    "PATH",
    "LD_LIBRARY_PATH",
    "LANG",
    "LC_ALL",
    "TZ",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENBLAS_CORETYPE",
    "CUDA_HOME",
    "CUDA_VISIBLE_DEVICES",
    "NVIDIA_VISIBLE_DEVICES",
    "NVIDIA_DRIVER_CAPABILITIES",
)
MAX_LOG_BYTES = 64 << 20
GRACE_S = 2.0
_POLL_S = 0.02


@dataclass(frozen=True)
class Finished:
    """How a program ended. stopped: why it was stopped ("timeout" or "log"), None if it ended by itself."""

    returncode: int
    seconds: float
    stopped: str | None = None


def clean_environment(work: Path, keep: Iterable[str] = (), extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """The variables of the allow-list that are set. HOME and TMPDIR point below ``work`` unless they are kept."""
    home, temporary = work / "home", work / "tmp"
    home.mkdir(parents=True, exist_ok=True)
    temporary.mkdir(parents=True, exist_ok=True)
    given = {"HOME": str(home), "TMPDIR": str(temporary), "XDG_RUNTIME_DIR": str(temporary)}
    kept = {k: os.environ[k] for k in (*ENVIRONMENT, *keep) if k in os.environ}
    return {**given, **kept, **(extra or {})}


def run_logged(
    argv: list[str],
    *,
    cwd: Path,
    environment: Mapping[str, str],
    log: Path,
    timeout_s: float,
    on_stop: Callable[[], None] | None = None,
) -> Finished:
    """Run ``argv`` with its output in ``log`` and wait. After ``timeout_s`` its whole process group is ended.

    on_stop: called when the program is stopped, to end what runs outside the group (a container). Ctrl-C ends the
    group too. Raises OSError if the program cannot be started.
    """
    begin = time.monotonic()
    with log.open("ab") as output:
        process = subprocess.Popen(
            argv,
            cwd=cwd,
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    stopped: str | None = None
    try:
        while process.poll() is None:
            if time.monotonic() - begin > timeout_s:
                stopped = "timeout"
            elif log.stat().st_size > MAX_LOG_BYTES:
                stopped = "log"
            if stopped:
                break
            time.sleep(_POLL_S)
    finally:
        if (stopped or process.poll() is None) and on_stop is not None:
            on_stop()
        end_group(process)
    return Finished(process.returncode, time.monotonic() - begin, stopped)


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a program, its process group and its descendants by SIGTERM, then by SIGKILL. Waits for the program."""
    others: list[psutil.Process] = []
    with contextlib.suppress(psutil.Error):
        others = psutil.Process(process.pid).children(recursive=True)
    try:
        if process.poll() is None:
            _signal(process.pid, others, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
    finally:  # also at a second Ctrl-C
        _signal(process.pid, others, signal.SIGKILL)
        process.wait()


def _signal(group: int, others: list[psutil.Process], number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
    for other in others:  # descendants that have left the group
        with contextlib.suppress(psutil.Error):
            other.send_signal(number)


def log_tail(log: Path, lines: int = 6, characters: int = 500) -> str:
    """The last lines of a log as one printable line, joined by " | "; empty without any."""
    return " | ".join(last_lines(log, lines))[-characters:]


def last_lines(log: Path, lines: int) -> list[str]:
    """Up to ``lines`` non-empty lines from the last 16 kB of a log, without unprintable characters."""
    try:
        with log.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - 16384))
            text = file.read().decode("utf-8", errors="replace")
    except OSError:
        return []
    clean = ("".join(c if c.isprintable() else " " for c in line).strip() for line in re.split(r"[\r\n]+", text))
    return [line for line in clean if line][-lines:]

"""Peak memory and processor time of a process tree, sampled by a thread."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from types import TracebackType

import psutil

PERIOD_S = 0.1


class Meter:
    """Use as a context manager around the work. Peaks are of this process and all its children together.

    Children are sampled every 0.1 s; of this process the kernel's own high-water mark counts too, so a
    short peak of it is not missed.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._process = psutil.Process(pid)
        self._own = pid is None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="panobench-meter", daemon=True)
        self._children_cpu: dict[int, float] = {}
        self._cpu_start = 0.0
        self.peak_rss_bytes = 0

    def __enter__(self) -> Meter:
        if self._own:
            _reset_high_water_mark()
        self._cpu_start = _cpu(self._process)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._measure()
        if self._own:
            self.peak_rss_bytes = max(self.peak_rss_bytes, _high_water_mark())

    @property
    def cpu_s(self) -> float:
        """Processor seconds used so far by this process and the children seen."""
        return _cpu(self._process) - self._cpu_start + sum(self._children_cpu.values())

    def _sample(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self._measure()

    def _measure(self) -> None:
        try:
            total = self._process.memory_info().rss
            children = self._process.children(recursive=True)
        except psutil.Error:
            return
        for child in children:
            try:
                total += child.memory_info().rss
                self._children_cpu[child.pid] = _cpu(child)
            except psutil.Error:
                continue
        self.peak_rss_bytes = max(self.peak_rss_bytes, total)


def _cpu(process: psutil.Process) -> float:
    try:
        times = process.cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)


def _reset_high_water_mark() -> None:
    # Where that is not possible the mark covers the whole life of the process.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _high_water_mark() -> int:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return 0
    for line in status.splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0

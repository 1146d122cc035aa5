"""Measure peak memory and processor time of this process and all it starts, by a thread that samples them."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path
from types import TracebackType

from panobench.bench.suite.process_tree import cpu_seconds, descendants, resident_bytes

PERIOD_S = 0.1


class Meter:
    """A context manager around the work. ``peak_rss_bytes`` counts this process and its children together.

    Children are sampled every 0.1 s; for this process the kernel's high-water mark counts too, so that a short peak is
    not missed.
    """

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="panobench-meter", daemon=True)
        self._cpu_start = 0.0
        self.peak_rss_bytes = 0

    def __enter__(self) -> Meter:
        _reset_high_water_mark()
        self._cpu_start = self._cpu()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._measure()
        self.peak_rss_bytes = max(self.peak_rss_bytes, _high_water_mark())

    @property
    def cpu_s(self) -> float:
        """Processor seconds used so far by this process and its children."""
        return self._cpu() - self._cpu_start

    def _cpu(self) -> float:
        return sum(map(cpu_seconds, [self._pid, *descendants(self._pid)]))

    def _sample(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self._measure()

    def _measure(self) -> None:
        self.peak_rss_bytes = max(self.peak_rss_bytes, tree_resident_bytes())


def tree_resident_bytes() -> int:
    """Resident memory of this process and all it has started."""
    pid = os.getpid()
    return sum(map(resident_bytes, [pid, *descendants(pid)]))


def _reset_high_water_mark() -> None:
    # where that is not possible the mark covers the whole life of the process
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

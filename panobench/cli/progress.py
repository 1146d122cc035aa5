"""The progress bar of `panobench run` shows the frame, frames per second and the error so far."""

from __future__ import annotations

import contextlib
import os
import threading
import time as clock
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from panobench.bench.run.observer import Observer
from panobench.geometry import umeyama

if TYPE_CHECKING:
    from panobench.types import Trajectory

#: Seconds between two updates of the error, which needs an alignment.
_ERROR_PERIOD_S = 0.5


#: Stages that follow the last frame.
_WITHOUT_FRAMES = ("finishing", "evaluating", "writing")


@dataclass(frozen=True)
class _Stage:
    """What the run is doing, and since when (monotonic, s)."""

    name: str
    began: float


class ProgressBar(Observer):
    """A progress bar on standard error; silent where that is no terminal."""

    def __init__(self, title: str, console: Console | None = None, verbose: bool = False) -> None:
        """verbose: also print the lines of log.txt, on a terminal or not."""
        self._console = console or Console(stderr=True)
        self._title, self._verbose = title, verbose
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TextColumn("{task.fields[error]}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[since]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._progress.add_task(title, total=None, rate="", error="", since="")
        self._truth: dict[float, NDArray[np.float64]] = {}
        self._estimated: list[NDArray[np.float64]] = []
        self._true: list[NDArray[np.float64]] = []
        self._busy_s = 0.0
        self._last_error = 0.0
        self._stage = _Stage("", clock.monotonic())
        self._stopped = threading.Event()
        self._ticker = threading.Thread(target=self._tick, name="progress", daemon=True)

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        if not self._progress.disable:
            self._ticker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        if self._ticker.is_alive():
            self._ticker.join()
        self._progress.stop()

    def stage(self, text: str) -> None:
        """A stage whose length nobody knows gets a moving bar and the seconds since it began."""
        self._stage = _Stage(text, clock.monotonic())
        self._progress.update(self._task, description=f"{self._title}: {text}", since="")
        if text in _WITHOUT_FRAMES:
            self._progress.update(self._task, total=None)

    def _tick(self) -> None:
        while not self._stopped.wait(0.5):
            stage = self._stage
            if stage.name in _WITHOUT_FRAMES:
                self._progress.update(self._task, since=f"{clock.monotonic() - stage.began:.0f} s")

    def found(self, dataset: str, what: str) -> None:
        self._console.print(f"{what}: --dataset {dataset}", markup=False, highlight=False, soft_wrap=True)

    def interrupted(self) -> None:
        """Past Python's buffers, which the signal may have found in use."""
        line = "panobench: finishing with the frames there are; once more keeps their poses and drops the map"
        with contextlib.suppress(OSError):
            os.write(2, f"\r\x1b[2K{line}\n".encode() if self._console.is_terminal else f"{line}\n".encode())

    def log(self, line: str) -> None:
        if self._verbose:
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def warn(self, text: str) -> None:
        self._console.print(f"warning: {text}", markup=False, highlight=False, soft_wrap=True)

    def compiling(self, done: int, total: int) -> None:
        """Says so on a terminal or not: it takes up to a minute, once."""
        if done == 0:
            line = f"compiling {total} kernels, once for this version of panobench and this machine"
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        self.stage("compiling kernels")
        finished = done == total
        self._progress.update(self._task, total=None if finished else total, completed=0 if finished else done)

    def started(self, total: int, truth: Trajectory | None) -> None:
        self._progress.update(self._task, total=total)
        if truth is not None:
            self._truth = dict(zip(truth.times.tolist(), truth.positions))

    def frame(self, index: int, time: float, T_wc: NDArray[np.float64] | None, latency_s: float) -> None:
        self._busy_s += latency_s
        if T_wc is not None and time in self._truth:
            self._estimated.append(T_wc[:3, 3])
            self._true.append(self._truth[time])
        self._progress.update(self._task, completed=index + 1, rate=f"tracking {self._rate(index + 1)}")
        now = clock.monotonic()
        if len(self._true) >= 3 and now - self._last_error >= _ERROR_PERIOD_S:
            self._last_error = now
            self._progress.update(self._task, error=f"ATE {1e3 * self._error_so_far():.1f} mm")

    def _rate(self, frames: int) -> str:
        """Frames per second of track() alone; the summary's whole system has finish() in it as well."""
        return f"{frames / max(self._busy_s, 1e-9):.1f} frames/s"

    def _error_so_far(self) -> float:
        estimated, true = np.array(self._estimated), np.array(self._true)
        moved = umeyama(estimated, true).apply_points(estimated)
        return float(np.sqrt(((moved - true) ** 2).sum(axis=1).mean()))

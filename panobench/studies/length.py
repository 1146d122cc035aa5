"""The length study: drift, scale, memory and time per frame of long runs against the path behind the camera."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panobench.api import Run
from panobench.bench.records.study_record import StudyResult
from panobench.errors import UsageError
from panobench.geometry import umeyama
from panobench.metrics.alignment import match, moves
from panobench.studies.base import StudyRequest
from panobench.studies.cells import QUICK, RunOptions, reasons, run_cells
from panobench.types import RunStatus, Trajectory

#: Runs whose frames are looked at; those that lost the camera show how far they came.
_WITH_FRAMES = (RunStatus.OK.value, RunStatus.LOST.value)


@dataclass(frozen=True)
class LengthOptions(RunOptions):
    """methods: "METHOD" or "METHOD:PRESET", each on every sequence. pieces: rows, as many frames each.

    window: frames over which the scale is taken; long enough that the camera gets on.
    """

    methods: tuple[str, ...] = ("sparse", "panogs:fast")
    sequences: tuple[str, ...] = ("building-entry",)
    pieces: int = 10
    window: int = 20

    def __post_init__(self) -> None:
        for name in ("pieces", "window"):
            if getattr(self, name) < 1:
                raise UsageError(f"study option {name}: must be at least 1")


@dataclass(frozen=True)
class Reached:
    """What a run was like when it had come so far.

    path: true metres behind the camera. ate: metres, of the frames so far after their own similarity alignment.
    scale: estimated over true way of the last ``window`` frames, over that of the first. latency: seconds, the mean of
    the piece. memory: MiB, at its end. tracked: share of the piece's frames. None or NaN: not measured.
    """

    frames: int
    path: float
    ate: float | None
    scale: float | None
    tracked: float
    latency: float
    memory: float


def run(study: StudyRequest) -> StudyResult:
    """A row for each piece of each run, and a chart over the path for each quantity."""
    options = study.choose(LengthOptions(), {**QUICK, "methods": ("sparse",), "pieces": 4, "window": 5})
    cells = {
        (method, sequence): options.cell(
            sequence, options.seeds[0], method=method.partition(":")[0], preset=method.partition(":")[2] or None
        )
        for sequence in options.sequences
        for method in options.methods
    }
    results = run_cells(study, "length", cells.values())
    runs: dict[str, list[Reached]] = {}
    for (method, sequence), cell in cells.items():
        stored = results.get(cell.identity)
        if stored is not None and stored.status in _WITH_FRAMES:
            name = method.replace(":", " ")
            label = f"{name}, {sequence}" if len(options.sequences) > 1 else name
            runs[label] = reached(Run(stored.folder), options.pieces, options.window)
    rows = [_row(label, one) for label, pieces in runs.items() for one in pieces]
    summary = [_growth(label, pieces) for label, pieces in runs.items() if len(pieces) > 1]
    notes = [
        f"{', '.join(options.sequences)}, {options.width} pixels wide, seed {options.seeds[0]}. ATE and drift are "
        "those of all frames so far, each time aligned anew by a similarity; the scale is the estimated way of "
        f"{options.window} frames over the true one, over that of the first {options.window}. Where loops are closed "
        "or the path is fitted at the end, the answer's early frames know the late ones.",
        *reasons(results, cells.values()),
    ]
    captions = {
        "length": "Against the path. Error of the frames so far, scale at its end, and of each piece time per frame, "
        "memory after it and the share of frames that have a pose.",
        "growth": "What grows. Time per frame and memory of the last piece over those of the second: the first has "
        "the start in it.",
        "drift": "Drift against path. ATE of the frames so far.",
        "scale": "Scale against path. Steps of the estimate over true ones, one at the start.",
        "time": "Time per frame against path.",
        "memory": "Memory against path. Resident memory of the process.",
    }
    figures = {
        "drift": _figure(runs, lambda r: _scaled(r.ate, 1e3), "ATE [mm]", "log"),
        "scale": _figure(runs, lambda r: r.scale, "scale"),
        "time": _figure(runs, lambda r: 1e3 * r.latency, "time per frame [ms]"),
        "memory": _figure(runs, lambda r: r.memory, "resident memory [MiB]"),
    }
    shown = {name: figure for name, figure in figures.items() if figure["data"]}
    return StudyResult("length", {"length": rows, "growth": summary}, shown, notes, "Length of the path", captions)


def reached(run: Run, pieces: int, window: int) -> list[Reached]:
    """What the run was like at the end of each of so many pieces with equally many frames."""
    times, truth = run.frames["time"], run.groundtruth
    latency, tracked = run.frames["latency_s"], run.frames["tracked"]
    memory = run.frames.get("memory_mib", np.full(len(times), math.nan))
    ends = np.unique(np.linspace(0, len(times), pieces + 1).round().astype(int))
    first = None
    found = []
    for a, b in itertools.pairwise(ends):
        last = times[b - 1] + 0.5e-6  # text has nine digits
        so_far = _until(run.trajectory, last)
        true_so_far = _until(truth, last) if truth is not None else None
        scale = _scale(so_far, true_so_far, float(times[max(0, b - window)]))
        if first is None and true_so_far is not None:
            first = _scale(so_far, _until(true_so_far, float(times[min(window, len(times) - 1)])), -math.inf)
        found.append(
            Reached(
                frames=int(b),
                path=true_so_far.path_length() if true_so_far is not None else math.nan,
                ate=_ate(so_far, true_so_far),
                scale=scale / first if scale is not None and first else None,
                tracked=float(tracked[a:b].mean()),
                latency=float(latency[a:b].mean()),
                memory=float(memory[b - 1]),
            )
        )
    return found


def _until(trajectory: Trajectory, time: float) -> Trajectory:
    return trajectory.select(np.flatnonzero(trajectory.times <= time))


def _ate(estimate: Trajectory, truth: Trajectory | None) -> float | None:
    """RMS distance in metres after the best similarity; None where it is not defined."""
    matched = match(estimate, truth)
    if matched is None or len(matched) < 3:
        return None
    source, target = matched.estimate.positions, matched.truth.positions
    if not (moves(source) and moves(target)):
        return None
    off = umeyama(source, target).apply_points(source) - target
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _scale(estimate: Trajectory, truth: Trajectory | None, since: float) -> float | None:
    """Way of the estimate over the true way, of the frames since a time; None where the camera stood still."""
    matched = match(estimate, truth)
    if matched is None:
        return None
    recent = np.flatnonzero(matched.truth.times >= since)
    way = matched.truth.select(recent).path_length()
    return matched.estimate.select(recent).path_length() / way if way > 1e-6 else None


def _scaled(value: float | None, by: float) -> float | None:
    return None if value is None else by * value


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _row(label: str, at: Reached) -> dict[str, Any]:
    """Without arrows: the pieces of a path do not compete, and none is the best."""
    return {
        "Run": label,
        "Frames": at.frames,
        "Path [m]": _known(at.path),
        "ATE [mm]": _scaled(at.ate, 1e3),
        "Drift [% of the path]": 100 * at.ate / at.path if at.ate is not None and at.path > 0 else None,
        "Scale": at.scale,
        "Tracked [%]": 100 * at.tracked,
        "Time per frame [ms]": _known(1e3 * at.latency),
        "Memory [MiB]": _known(at.memory),
    }


def _growth(label: str, pieces: Sequence[Reached]) -> dict[str, Any]:
    """The last piece beside the second."""
    early, late = pieces[min(1, len(pieces) - 2)], pieces[-1]
    return {
        "Run": label,
        "Time per frame, times ↓": late.latency / early.latency if early.latency > 0 else None,
        "Memory, times ↓": _known(late.memory / early.memory) if early.memory > 0 else None,
        "Memory per 100 frames [MiB] ↓": _known(100 * (late.memory - early.memory) / (late.frames - early.frames)),
    }


def _figure(
    runs: dict[str, list[Reached]], value: Callable[[Reached], float | None], title: str, kind: str = "linear"
) -> dict[str, Any]:
    """A line per run over the path in metres; over frames where nothing has a true path."""
    every = [one for pieces in runs.values() for one in pieces]
    measured = any(math.isfinite(one.path) for one in every)
    data = []
    for k, (label, pieces) in enumerate(runs.items()):
        points = [
            (one.path if measured else float(one.frames), y)
            for one in pieces
            if (y := value(one)) is not None and math.isfinite(y)
        ]
        if points:
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines+markers",
                    "name": label,
                    "meta": {"run": -2, "colour": k},
                    "x": [x for x, _ in points],
                    "y": [y for _, y in points],
                    "line": {"width": 2},
                    "marker": {"size": 7},
                }
            )
    layout = {
        "xaxis": {"title": {"text": "path [m]" if measured else "frames"}},
        "yaxis": {"title": {"text": title}, "type": kind, **({} if kind == "log" else {"rangemode": "tozero"})},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}

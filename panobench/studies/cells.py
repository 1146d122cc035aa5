"""What studies that make runs share: options, running cells as a suite does, and one number per cell."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, make_dataclass
from typing import Any, get_type_hints

from panobench.bench.records.statistics import summarise
from panobench.bench.run.request import RunRequest, run_options
from panobench.bench.suite.cells import Cell, Limits, Planned
from panobench.bench.suite.runner import SuiteRunner, make_plan
from panobench.bench.suite.store import Store, Stored
from panobench.studies.base import StudyRequest
from panobench.types import RunStatus

FAILED = "/"


#: The run options that suite files have under ``options``, as a dataclass; studies take all of them.
_SuiteOptions: Any = make_dataclass(
    "_SuiteOptions", [(o.name, o.type, o.default) for o in run_options() if not o.suite_key], frozen=True
)


@dataclass(frozen=True)
class RunOptions(_SuiteOptions):
    """Options of every study that runs a method: which, on what, how often, and for how long at most.

    Those of a suite's ``options`` are among them. width: 256 pixels show the same order of a study's rows as 512, at a
    fourth of the cost.
    """

    method: str = "panogs"
    preset: str | None = None
    dataset: str = "rooms"
    root: str | None = None
    sequences: tuple[str, ...] = ("room1", "room2", "room3", "room4", "room5")
    seeds: tuple[int, ...] = (0,)
    width: int = 256
    timeout_s: float = 3600.0
    memory_gib: float = 8.0

    def request(self, sequence: str, seed: int, **changes: Any) -> RunRequest:
        """A run of these options; ``changes`` are fields of RunRequest.

        A study may use the name of a run option for a field of another type, such as a list of fields of view. Such a
        field is not passed on to runs.
        """
        mine, usual = get_type_hints(type(self)), get_type_hints(RunOptions)
        given = {
            option.name: getattr(self, option.name)
            for option in run_options()
            if option.name in usual and mine[option.name] == usual[option.name]
        }
        return RunRequest(**{**given, "sequence": sequence, "seed": seed, **changes})

    def cell(self, sequence: str, seed: int, **changes: Any) -> Cell:
        limits = Limits(timeout_s=self.timeout_s, memory_gib=self.memory_gib)
        return Cell(self.request(sequence, seed, **changes), limits=limits)


#: A run of the smallest room that still has something to track.
QUICK: dict[str, Any] = {"sequences": ("tiny",), "width": 128, "max_frames": 24}


class _Lines:
    """A ``Watcher`` that reports a line per cell."""

    def __init__(self, study: StudyRequest, total: int, done: int) -> None:
        self._study, self._total, self._done = study, total, done
        self._lock = threading.Lock()

    def started(self, planned: Planned) -> None:
        with self._lock:
            self._study.say(f"[{self._done + 1}/{self._total}] running {planned.cell.label}")

    def finished(self, planned: Planned, stored: Stored, note: str) -> None:
        with self._lock:
            self._done += 1
            ate = stored.record.number("ate_rmse_m")
            words = [stored.status] + ([f"ATE {1e3 * ate:.2f} mm"] if ate is not None else []) + [note]
            self._study.say(f"[{self._done}/{self._total}] {' '.join(w for w in words if w)}")


def run_cells(study: StudyRequest, name: str, cells: Iterable[Cell]) -> dict[str, Stored]:
    """Run what the store in ``study.out`` does not hold yet, and return the results by the cells' identity.

    Every cell ends with a result, be it a failure. Raises OutputError when the store cannot be written.
    """
    cells = list(cells)
    store = Store(study.out)
    plan = make_plan(cells, store, study.retry)
    for moved in plan.quarantined:
        study.say(f"{moved.reason}; moved away: {moved.folder}")
    lines = _Lines(study, len(plan.rows), len(plan.rows) - len(plan.todo))
    SuiteRunner(store, f"study-{name}", lines).run(plan, study.jobs)
    found = {cell.identity: store.check(cell)[0] for cell in cells}
    return {identity: stored for identity, stored in found.items() if stored is not None}


def values(results: dict[str, Stored], cells: Sequence[Cell], key: str) -> list[float | None]:
    """A metric or timing of each cell, None where it failed; empty when those that succeeded did not measure it."""
    found: list[float | None] = []
    for cell in cells:
        stored = results.get(cell.identity)
        if stored is None:  # nobody ran it, which is no failure
            continue
        if not stored.record.ok:
            found.append(None)
            continue
        value = stored.record.number(key)
        if value is None:
            return []
        found.append(value)
    return found


def median(
    results: dict[str, Stored], cells: Sequence[Cell], key: str, scale: float = 1.0, *, higher_is_better: bool = False
) -> float | str | None:
    """The median over repeats of one row on one sequence: "/" if failures decide it, None if not measured."""
    return middle(values(results, cells, key), scale, higher_is_better=higher_is_better)


def middle(
    numbers: Sequence[float | None], scale: float = 1.0, *, higher_is_better: bool = False
) -> float | str | None:
    """The median of numbers, of which None is a failure: "/" if failures decide it, None without numbers."""
    summary = summarise(numbers, higher_is_better=higher_is_better)
    if summary is None:
        return None
    return summary.median * scale if math.isfinite(summary.median) else FAILED


def mean(medians: Sequence[float | str | None]) -> float | str | None:
    """The mean over sequences: "/" if one of them failed, None if one was not measured or there is none."""
    if any(m == FAILED for m in medians):
        return FAILED
    numbers = [m for m in medians if isinstance(m, float)]
    return sum(numbers) / len(numbers) if numbers and len(numbers) == len(medians) else None


def geometric_mean(medians: Sequence[float | str | None]) -> float | str | None:
    """As ``mean``, but no sequence outweighs the others: errors of rooms differ by a factor of a hundred."""
    if any(m == FAILED for m in medians):
        return FAILED
    numbers = [m for m in medians if isinstance(m, float) and m > 0]
    if not numbers or len(numbers) != len(medians):
        return None
    return math.exp(sum(math.log(n) for n in numbers) / len(numbers))


def reasons(results: dict[str, Stored], cells: Iterable[Cell]) -> list[str]:
    """A line for each cell that did not succeed."""
    lines = []
    for cell in cells:
        stored = results.get(cell.identity)
        if stored is None:
            lines.append(f"{cell.label}: not run")
        elif stored.status != RunStatus.OK.value:
            lines.append(f"{cell.label}: {stored.status}, {stored.record.message}".rstrip(", "))
    return lines

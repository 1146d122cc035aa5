"""Run a suite: plan its cells, find which are done, run the others, and end each with a status.

Any number of suites may work on one store at once: the one that holds a cell's lock runs it.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from panobench.bench.records.record import CellRecord
from panobench.bench.suite.cells import Cell, Planned, Planner
from panobench.bench.suite.failure import write_failure
from panobench.bench.suite.isolated import InfrastructureError, Interrupted, Stopper, run_isolated
from panobench.bench.suite.store import Quarantined, Store, Stored
from panobench.errors import UnknownNameError
from panobench.types import RunStatus
from panobench.writing import writing

#: The statuses that `--retry failed` means: none of them is a result of the method on this data.
FAILED = ("timeout", "out-of-memory", "crashed", "unsupported", "unavailable", "interrupted")
#: How often a cell is tried when the process that watches over it is lost; then it counts as interrupted.
ATTEMPTS = 3


@dataclass(frozen=True)
class Row:
    """A cell of the plan, its stored result if any, and why it has to be run ("": the result stands)."""

    planned: Planned
    stored: Stored | None = None
    reason: str = ""

    @property
    def status(self) -> str:
        return self.stored.status if self.stored else ""


@dataclass
class Plan:
    """All rows in the suite's order, and what was moved to the quarantine while looking."""

    rows: list[Row]
    quarantined: list[Quarantined] = field(default_factory=list)

    @property
    def todo(self) -> list[Row]:
        return [row for row in self.rows if row.reason]


class Watcher(Protocol):
    """Is told about every cell, from the threads that run cells."""

    def started(self, planned: Planned) -> None: ...

    def finished(self, planned: Planned, stored: Stored, note: str) -> None: ...


def choose(cells: Iterable[Cell], only: Sequence[str]) -> list[Cell]:
    """Cells whose label matches one of the patterns (shell wildcards, or a part of it); all without patterns."""
    cells = list(cells)
    chosen = [c for c in cells if not only or any(_matches(c.label, p) for p in only)]
    if not chosen:
        raise UnknownNameError("selection --only", ", ".join(only), [c.label for c in cells[:10]])
    return chosen


def _matches(label: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(label, pattern) or pattern in label


def parse_retry(words: Iterable[str]) -> frozenset[str]:
    """Statuses of `--retry failed,lost`. Raises UnknownNameError."""
    known = [s.value for s in RunStatus]
    chosen: set[str] = set()
    for word in (w.strip() for text in words for w in text.split(",")):
        if word == "failed":
            chosen.update(FAILED)
        elif word in known:
            chosen.add(word)
        else:
            raise UnknownNameError("status for --retry", word, ["failed", *known])
    return frozenset(chosen)


def make_plan(
    cells: Iterable[Cell], store: Store, retry: frozenset[str] = frozenset(), move_damaged: bool = True
) -> Plan:
    """Find what is left to do. Damaged results are moved to the quarantine, and their cells planned again."""
    planner, plan = Planner(), Plan([])
    for cell in cells:
        planned = planner.plan(cell)
        stored, damaged = store.check(cell, move_damaged)
        if damaged:
            plan.quarantined.append(damaged)
        reason = why_run(planned, stored, retry)
        if damaged:
            reason = "its stored result was damaged"
        plan.rows.append(Row(planned, stored, reason))
    return plan


def why_run(planned: Planned, stored: Stored | None, retry: frozenset[str]) -> str:
    """Why a cell has to be run, "" if its result stands."""
    if stored is None:
        return "new"
    if stored.key != planned.key:
        return "code, data, options or packages have changed"
    if stored.status == RunStatus.INTERRUPTED.value:
        return "it was interrupted"
    if stored.status in retry:
        return f"retry of {stored.status}"
    limits = planned.cell.limits
    for status, name, limit in (
        ("timeout", "timeout_s", limits.timeout_s),
        ("out-of-memory", "memory_gib", limits.memory_gib),
    ):
        if stored.status == status and stored.limits.get(name, 0.0) < limit:
            return f"its limit {name} was raised"
    return ""


def entry(planned: Planned, suite: str, attempt: int = 1) -> CellRecord:
    """The cell's entry in the record of its run."""
    cell = planned.cell
    return CellRecord(suite, planned.key, cell.identity, cell.label, cell.repeat, asdict(cell.limits), attempt)


def compute(
    planned: Planned,
    suite: str,
    place: Path,
    stopper: Stopper,
    run: Callable[[Cell, CellRecord, Path, Stopper], Path] | None = None,
) -> Path:
    """Run the cell, or write down why it cannot run. Returns its run folder, below ``place``.

    run: what runs it; by default ``run_isolated`` on this machine.
    """
    run = run or run_isolated
    if planned.status is not None:
        about = entry(planned, suite)
        return write_failure(place / "run", planned.cell.request, planned.status, planned.message, cell=about)
    for attempt in range(1, ATTEMPTS + 1):
        there = place / f"attempt-{attempt}"
        with writing(place):
            there.mkdir()
        try:
            return run(planned.cell, entry(planned, suite, attempt), there, stopper)
        except Interrupted:
            lost = "interrupted"
        except InfrastructureError as error:
            lost = str(error)
        if stopper.requested:
            break
    message = f"not run to its end: {lost}"
    about = entry(planned, suite, attempt)
    return write_failure(place / "run", planned.cell.request, RunStatus.INTERRUPTED, message, cell=about)


@dataclass
class SuiteRunner:
    """Runs what a plan leaves to do. ``compute`` may work on other machines; this process owns locks and store."""

    store: Store
    suite: str
    watcher: Watcher
    stopper: Stopper = field(default_factory=Stopper)
    compute: Callable[[Planned, str, Path, Stopper], Path] = compute

    def run(self, plan: Plan, jobs: int = 1) -> None:
        """Run all cells to do, ``jobs`` at a time: first those that no other suite works on, then the others.

        Raises OutputError when the store cannot be written. Finished cells stay, the others are as before.
        """
        busy = self._pass(plan.todo, jobs, wait=False)
        if busy and not self.stopper.requested:
            self._pass(busy, jobs, wait=True)

    def _pass(self, rows: Sequence[Row], jobs: int, wait: bool) -> list[Row]:
        """Run ``rows`` and return the cells that another process was working on."""
        with ThreadPoolExecutor(jobs, thread_name_prefix="cell") as pool:
            futures = {pool.submit(self.run_cell, row, wait): row for row in rows}
            try:
                wait_for(futures, return_when=FIRST_EXCEPTION)
            except BaseException:
                self.stopper.stop()
                raise
            finally:
                if any(f.done() and f.exception() for f in futures):
                    self.stopper.stop()
                pool.shutdown(cancel_futures=True)
        return [row for future, row in futures.items() if future.result() == "busy"]

    def run_cell(self, row: Row, wait: bool = False) -> str:
        """Run one cell: "busy" if another process has it, "skipped" after a stop, else "done"."""
        if self.stopper.requested:
            return "skipped"
        planned = row.planned
        with self.store.lock(planned.cell, wait) as mine:
            if not mine:
                return "busy"
            stored, _ = self.store.check(planned.cell)
            theirs = stored is not None and (row.stored is None or row.stored.stamp != stored.stamp)
            if stored is not None and theirs and not why_run(planned, stored, frozenset()):
                self.watcher.finished(planned, stored, "done by another process")
                return "done"
            self.watcher.started(planned)
            with self.store.workplace(planned.cell) as place:
                stored = self.store.put(planned, self.compute(planned, self.suite, place, self.stopper))
            self.watcher.finished(planned, stored, "")
            return "done"


def counts(rows: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """The number of rows by status, in the order in which statuses are defined."""
    found: dict[str, int] = {}
    for row in rows:
        found[row["status"]] = found.get(row["status"], 0) + 1
    order = [s.value for s in RunStatus]
    return {s: found[s] for s in sorted(found, key=lambda s: order.index(s) if s in order else len(order))}

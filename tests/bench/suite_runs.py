"""Small suites of fake methods, run in this process or in processes of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from panobench.bench.run.request import RunRequest
from panobench.bench.suite.cells import Cell, Limits, Planned
from panobench.bench.suite.isolated import Stopper
from panobench.bench.suite.runner import SuiteRunner, make_plan, parse_retry
from panobench.bench.suite.store import Store, Stored


class Silent:
    def __init__(self) -> None:
        self.notes: list[tuple[str, str]] = []

    def started(self, planned: Planned) -> None:
        self.notes.append(("started", planned.cell.label))

    def finished(self, planned: Planned, stored: Stored, note: str) -> None:
        self.notes.append((stored.status, planned.cell.label))


def cell(method: str = "still", seed: int = 0, **options: Any) -> Cell:
    limits = options.pop("limits", Limits(timeout_s=300))
    values: dict[str, Any] = {"dataset": "tiny", "sequence": "blind", "width": 64, "max_frames": 4, **options}
    return Cell(RunRequest(method=f"fake-{method}", seed=seed, **values), limits=limits)


def quick(planned: Planned, suite: str, place: Path, stopper: Stopper) -> Path:
    """The run in this process: for tests of everything around it."""
    from panobench.bench.run.runner import execute
    from panobench.bench.suite.runner import entry

    if planned.status is not None:
        from panobench.bench.suite.runner import compute

        return compute(planned, suite, place, stopper)
    return execute(planned.cell.request, place / "run", cell=entry(planned, suite))


def run(store: Store, cells: list[Cell], retry: str = "", compute: Any = quick, jobs: int = 1) -> Silent:
    watcher = Silent()
    plan = make_plan(cells, store, parse_retry([retry] if retry else []))
    SuiteRunner(store, "test", watcher, compute=compute).run(plan, jobs)
    return watcher


def statuses(store: Store, cells: list[Cell]) -> list[str]:
    found = [store.find(c) for c in cells]
    return [f.status if f else "" for f in found]


def processes(place: Path, module: bytes) -> list[str]:
    """Ids of processes whose command line names a path below ``place``, and a Python module."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if any(str(place).encode() in w for w in words) and module in b" ".join(words):
            found.append(path.parent.name)
    return found

"""The live table of `panobench suite run`; where there is no terminal, a line per finished cell."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from panobench.bench.records.cautions import cautions
from panobench.bench.suite.cells import Planned
from panobench.bench.suite.runner import Plan, counts
from panobench.bench.suite.store import Stored
from panobench.cli.table import STYLES

_SHOWN = 12


class SuiteTable:
    """A ``Watcher`` that shows running cells, the last finished ones, and counts."""

    def __init__(self, name: str, plan: Plan, show: bool) -> None:
        self._name, self._total = name, len(plan.rows)
        self._statuses = [{"status": row.stored.status} for row in plan.rows if row.stored and not row.reason]
        self._running: dict[str, float] = {}
        self._finished: list[tuple[str, Stored, str]] = []
        self._lock = threading.Lock()
        self._console = Console(stderr=True)
        self._show = show
        self._live = (
            Live(console=self._console, refresh_per_second=2, get_renderable=self._render)
            if show and self._console.is_terminal
            else None
        )

    def __enter__(self) -> SuiteTable:
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def started(self, planned: Planned) -> None:
        with self._lock:
            self._running[planned.cell.label] = time.monotonic()

    def finished(self, planned: Planned, stored: Stored, note: str) -> None:
        with self._lock:
            self._running.pop(planned.cell.label, None)
            self._finished.append((planned.cell.label, stored, note))
            self._statuses.append({"status": stored.status})
            if self._show and not self._live:
                done = f"[{len(self._statuses)}/{self._total}]"
                print(f"{done} {stored.status:13} {planned.cell.label}  {_numbers(stored)}".rstrip(), file=sys.stderr)

    def _render(self) -> Table:
        with self._lock:
            summary = ", ".join(f"{n} {s}" for s, n in counts(self._statuses).items())
            title = f"{self._name}: {len(self._statuses)} of {self._total} cells  {summary}"
            table = Table(title=title, title_justify="left", expand=True)
            for column in ("cell", "status", "result"):
                table.add_column(column, overflow="ellipsis", no_wrap=column != "result")
            for label, stored, note in self._finished[-_SHOWN:]:
                style = STYLES.get(stored.status, "red")
                # names and messages come from data and must not be read as markup
                table.add_row(Text(label), Text(stored.status, style), Text(note or _numbers(stored)))
            for label, begin in self._running.items():
                table.add_row(Text(label), Text("running", "cyan"), f"{time.monotonic() - begin:.0f} s")
            return table


def _numbers(stored: Stored) -> str:
    if stored.status not in ("ok", "lost"):
        return stored.record.message
    number, words = stored.record.number, []
    if (ate := number("ate_rmse_m")) is not None:
        words.append(f"ATE {1e3 * ate:.2f} mm")
    if (tracked := number("tracked")) is not None:
        words.append(f"tracked {tracked:.0%}")
    if fps := number("fps"):
        words.append(f"{fps:.1f} frames/s")
    words += [f"({word})" for word in cautions(stored.record)]
    return "  ".join(words)

"""The store of a suite's runs: one folder per cell, safe against kill -9, full disks and a second suite.

Layout below the store's root:
  runs/SLUG/          the cells' run folders, each renamed into place when it is complete
  _quarantine/        run folders that could not be read, with the time they were found
  _superseded/        results replaced by a newer one of the same cell (changed code or data, or a retry)
  .locks/SLUG         held while a cell is being worked on; freed by the system when its process dies
  .work/              cells being worked on; whatever no living process holds is swept
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from panobench.bench.records.record import RunRecord, read_record
from panobench.bench.records.runfolder import RUN_JSON
from panobench.bench.suite.cells import Cell, Planned
from panobench.errors import InputError
from panobench.locking import lock
from panobench.writing import writing

RUNS, QUARANTINE, SUPERSEDED, LOCKS, WORK = "runs", "_quarantine", "_superseded", ".locks", ".work"
#: How many replaced results of one cell are kept.
_KEEP = 3


@dataclass(frozen=True)
class Stored:
    """A readable run folder of the store. stamp: differs when the folder is replaced by another in the same place."""

    folder: Path
    record: RunRecord
    stamp: tuple[int, int] = (0, 0)

    @property
    def key(self) -> str:
        return self.record.cell.key if self.record.cell else ""

    @property
    def status(self) -> str:
        return self.record.status

    @property
    def limits(self) -> Mapping[str, float]:
        return self.record.cell.limits if self.record.cell else {}


def _stamp(folder: Path) -> tuple[int, int]:
    try:
        about = (folder / RUN_JSON).stat()
    except OSError:
        return 0, 0
    return about.st_ino, about.st_mtime_ns


@dataclass(frozen=True)
class Quarantined:
    """A run folder that cannot be used, and where it is now."""

    folder: Path
    reason: str


class Store:
    """A store. Its operations name a cell by its slug, and several processes may call them at once."""

    def __init__(self, root: Path) -> None:
        """Folders are made when the first cell is locked, not here."""
        self.root = Path(os.path.abspath(root))

    def require(self) -> Store:
        """Return the store. Raises InputError when there is none."""
        if not (self.root / RUNS).is_dir():
            raise InputError("not a suite's store: it has no runs/", self.root)
        return self

    def folder(self, cell: Cell) -> Path:
        return self.root / RUNS / cell.slug

    def find(self, cell: Cell) -> Stored | None:
        """The cell's stored result. Raises InputError when there is one that cannot be read."""
        folder = self.folder(cell)
        if not folder.exists():
            return None
        stamp = _stamp(folder)
        record = read_record(folder)
        if record.cell is None or record.cell.identity != cell.identity:
            raise InputError("it belongs to another cell than its folder's name says", folder / "run.json")
        return Stored(folder, record, stamp)

    def check(self, cell: Cell, move: bool = True) -> tuple[Stored | None, Quarantined | None]:
        """The stored result, or the damaged one, which is moved to the quarantine if ``move``."""
        try:
            return self.find(cell), None
        except InputError as error:
            folder, reason = self.folder(cell), str(error)
            return None, self.quarantine(folder, reason) if move else Quarantined(folder, reason)

    def runs(self) -> tuple[list[Stored], list[Quarantined]]:
        """Every result in the store, and the damaged ones; nothing is moved."""
        found, damaged = [], []
        for folder in sorted(p for p in (self.root / RUNS).iterdir() if p.is_dir() and not p.name.startswith(".")):
            try:
                found.append(Stored(folder, read_record(folder), _stamp(folder)))
            except InputError as error:
                damaged.append(Quarantined(folder, str(error)))
        return found, damaged

    def quarantine(self, folder: Path, reason: str) -> Quarantined:
        """Move a damaged folder away, with the reason beside it."""
        target = self._aside(QUARANTINE, folder.name)
        with writing(self.root):
            os.rename(folder, target)
            (target / "quarantine.txt").write_text(reason + "\n", encoding="utf-8")
        return Quarantined(target, reason)

    def quarantined(self) -> list[Quarantined]:
        """Everything in the quarantine."""
        found = []
        for folder in sorted((self.root / QUARANTINE).glob("*")):
            note = folder / "quarantine.txt"
            reason = note.read_text(encoding="utf-8").strip() if note.is_file() else "no reason recorded"
            found.append(Quarantined(folder, reason))
        return found

    @contextlib.contextmanager
    def lock(self, cell: Cell, wait: bool = False) -> Iterator[bool]:
        """Hold the cell's lock; yields False, holding nothing, when another process has it and ``wait`` is False."""
        with writing(self.root):
            for name in (RUNS, LOCKS, WORK):
                (self.root / name).mkdir(parents=True, exist_ok=True)
            handle = os.open(self.root / LOCKS / cell.slug, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            yield lock(handle, self.root / LOCKS / cell.slug, wait)
        finally:
            os.close(handle)

    @contextlib.contextmanager
    def workplace(self, cell: Cell) -> Iterator[Path]:
        """An empty folder for the cell's worker, removed afterwards. Hold the cell's lock."""
        place = self.root / WORK / cell.slug
        with writing(self.root):
            shutil.rmtree(place, ignore_errors=True)  # of a process that was killed
            place.mkdir(parents=True)
        try:
            yield place
        finally:
            shutil.rmtree(place, ignore_errors=True)

    def put(self, planned: Planned, folder: Path) -> Stored:
        """Move a complete run folder (in the store's file system) into the cell's place. Hold the cell's lock."""
        target = self.folder(planned.cell)
        record = read_record(folder)
        with writing(self.root):
            if target.exists():
                os.rename(target, self._aside(SUPERSEDED, target.name))
                self._forget_old(target.name)
            os.rename(folder, target)
        return Stored(target, record, _stamp(target))

    def _aside(self, kind: str, name: str) -> Path:
        """A free folder name below _quarantine or _superseded."""
        with writing(self.root):
            (self.root / kind).mkdir(exist_ok=True)
        stamp = time.strftime("%Y%m%d-%H%M%S")
        target, number = self.root / kind / f"{name}.{stamp}", 1
        while target.exists():
            number += 1
            target = self.root / kind / f"{name}.{stamp}-{number}"
        return target

    def _forget_old(self, name: str) -> None:
        old = sorted((self.root / SUPERSEDED).glob(f"{name}.*"), key=lambda p: p.stat().st_mtime)
        for folder in old[:-_KEEP]:
            shutil.rmtree(folder, ignore_errors=True)

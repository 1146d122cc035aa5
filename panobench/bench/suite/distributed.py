"""Run cells on other machines through dask.distributed. The store, its locks and all decisions stay with the suite.

A worker runs a cell in a process of its own, as the local executor does, on its own disk, and sends the run folder
back as a tar archive: only the data need a path that all machines share.
"""

from __future__ import annotations

import contextlib
import io
import tarfile
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from panobench.bench.records.record import CellRecord
from panobench.bench.suite.cells import Cell, Planned, Planner
from panobench.bench.suite.isolated import InfrastructureError, Interrupted, Stopper, run_isolated
from panobench.bench.suite.runner import compute
from panobench.errors import InputError, UnavailableError, UsageError
from panobench.writing import writing

#: Seconds between two checks whether a cell is still wanted.
_POLL_S = 1.0
#: Seconds to wait for a scheduler.
CONNECT_S = 30.0
#: A larger run folder is refused rather than unpacked.
MAX_UNPACKED_BYTES = 4 << 30


class DaskCompute:
    """Computes cells for a ``SuiteRunner``, ``parallel`` of them at a time.

    scheduler: address of a running scheduler, None for a cluster of ``jobs`` workers on this machine.
    """

    def __init__(self, scheduler: str | None, jobs: int) -> None:
        try:
            import dask
            import distributed
        except ModuleNotFoundError as error:
            raise UnavailableError("--executor dask needs the extra: pip install 'panobench[dask]'") from error
        self._cluster: Any = None
        if scheduler is None:
            # when a worker dies the suite tries again and counts the attempts; the scheduler must not
            dask.config.set({"distributed.scheduler.allowed-failures": 0})
            self._cluster = distributed.LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, memory_limit=0
            )
        try:
            self.client = distributed.Client(self._cluster or scheduler, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise UsageError(f"--scheduler {scheduler}: cannot be reached ({error})") from error
        self.parallel = max(jobs, sum(self.client.nthreads().values()))

    def __enter__(self) -> DaskCompute:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close()
        if self._cluster is not None:
            self._cluster.close()

    def __call__(self, planned: Planned, suite: str, place: Path, stopper: Stopper) -> Path:
        return compute(planned, suite, place, stopper, run=self._run_for(planned))

    def _run_for(self, planned: Planned) -> Callable[[Cell, CellRecord, Path, Stopper], Path]:
        """A function that does ``run_isolated`` on a worker."""

        def run(cell: Cell, entry: CellRecord, place: Path, stopper: Stopper) -> Path:
            from concurrent.futures import CancelledError

            from distributed.scheduler import KilledWorker

            future = self.client.submit(
                run_remotely, cell.to_dict(), planned.key, entry.to_dict(), pure=False, retries=0
            )
            with stopper.watching(future.cancel):
                try:
                    archive = future.result()
                except KilledWorker as error:
                    raise InfrastructureError(f"the worker that ran '{cell.label}' was lost") from error
                except CancelledError as error:
                    if stopper.requested:
                        raise Interrupted from error
                    raise InfrastructureError(f"the scheduler gave up '{cell.label}'") from error
                except OSError as error:  # the connection to the scheduler
                    raise InfrastructureError(f"lost contact while '{cell.label}' ran: {error}") from error
            return unpack(archive, place)

        return run


def run_remotely(values: dict[str, Any], key: str, entry: dict[str, Any]) -> bytes:
    """Run the cell in a worker and return its run folder as a tar archive.

    Raises UsageError when the worker's code, packages or data differ from the suite's: its result would not belong
    under the cell's key.
    """
    cell = Cell.from_dict(values)
    mine = Planner().plan(cell)
    if mine.key != key:
        reason = mine.message or "its code, packages or data differ from those of the suite's machine"
        raise UsageError(f"a worker cannot run '{cell.label}': {reason}")
    with tempfile.TemporaryDirectory(prefix="panobench-cell-", ignore_cleanup_errors=True) as work:
        place = Path(work) / "cell"
        place.mkdir()
        stopper = Stopper()
        with _watch_task(stopper):
            return pack(run_isolated(cell, CellRecord.from_dict(entry), place, stopper))


class _watch_task:
    """Stops the run when its task is cancelled, or nobody waits for it any more."""

    def __init__(self, stopper: Stopper) -> None:
        from distributed import get_worker

        self._stopper, self._done = stopper, threading.Event()
        self._tasks: Any = None
        with contextlib.suppress(ValueError):  # it is called outside a worker
            worker = get_worker()
            self._tasks, self._key = worker.state.tasks, worker.get_current_task()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> None:
        if self._tasks is not None:
            self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._done.set()

    def _look(self) -> None:
        while not self._done.wait(_POLL_S):
            task = self._tasks.get(self._key)
            if task is None or task.state == "cancelled":
                self._stopper.stop()
                return


def pack(folder: Path) -> bytes:
    """A folder as a tar archive."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, arcname="run")
    return buffer.getvalue()


def unpack(content: bytes, place: Path) -> Path:
    """The folder of ``pack``, below ``place``. Only plain files and folders inside it are accepted."""
    try:
        with writing(place), tarfile.open(fileobj=io.BytesIO(content)) as archive:
            members = archive.getmembers()
            if sum(m.size for m in members) > MAX_UNPACKED_BYTES:
                raise InputError(f"a worker sent a run of more than {MAX_UNPACKED_BYTES >> 30} GiB")
            for member in members:
                parts = Path(member.name).parts
                if parts[:1] != ("run",) or ".." in parts or not (member.isfile() or member.isdir()):
                    raise InputError(f"a worker sent a run with the entry '{member.name}'")
            for member in members:
                target = place / member.name
                if member.isdir():
                    target.mkdir(parents=True, exist_ok=True)
                else:
                    target.parent.mkdir(parents=True, exist_ok=True)
                    source = archive.extractfile(member)
                    assert source is not None
                    target.write_bytes(source.read())
    except tarfile.TarError as error:
        raise InputError(f"a worker sent something that is no archive ({error})") from error
    return place / "run"

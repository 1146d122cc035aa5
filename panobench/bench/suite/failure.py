"""Write run folders for runs that left none: they were killed, ran out of time or memory, or could not start."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from panobench.bench.records.provenance import provenance
from panobench.bench.records.record import CellRecord, TimingRecord, empty_record, write_record
from panobench.bench.records.runfolder import FRAMES, LOG, TRAJECTORY, PendingRun, write_frames
from panobench.bench.run.request import RunRequest
from panobench.types import RunStatus
from panobench.writing import TEXT

#: How much of each log is kept.
MAX_LOG_BYTES = 1 << 20


def write_failure(
    out: Path,
    request: RunRequest,
    status: RunStatus,
    message: str,
    *,
    log: str = "",
    timing: TimingRecord | None = None,
    cell: CellRecord | None = None,
    isolation: dict[str, Any] | None = None,
) -> Path:
    """Write a complete run folder without results at ``out``."""
    record = empty_record(request, status, message)
    record.provenance = provenance()
    record.provenance.command = shlex.join(request.command())
    record.timing = timing or record.timing
    record.cell, record.isolation = cell, isolation
    with PendingRun(out) as pending:
        (pending.path / LOG).write_text(log + f"\n{status.value}: {message}\n", **TEXT)
        (pending.path / TRAJECTORY).write_text("# time x y z qx qy qz qw (camera-to-world)\n", encoding="utf-8")
        write_frames(pending.path / FRAMES, [])
        write_record(pending.path, record)
        return pending.publish()


def tail(path: Path, size: int = MAX_LOG_BYTES) -> str:
    """The last bytes of a text file, from a line's start; "" if there is none."""
    try:
        with path.open("rb") as file:
            file.seek(0, 2)
            start = max(0, file.tell() - size)
            file.seek(start)
            text = file.read().decode("utf-8", errors="replace")
    except OSError:
        return ""
    return text.partition("\n")[2] if start else text

"""The process in which an isolated run happens: ``python -m panobench.bench.suite.worker CELL.json OUT``.

It writes a run folder OUT, without frames if the run cannot start for a reason that the user can mend. Exit codes: 0 a
run folder is there, 75 the disk is full; anything else is a crash.
"""

from __future__ import annotations

import faulthandler
import json
import sys
import traceback
from pathlib import Path

from panobench.bench.records.record import CellRecord
from panobench.bench.run.runner import execute
from panobench.bench.suite.cells import Cell
from panobench.bench.suite.failure import write_failure
from panobench.errors import InputError, PanobenchError
from panobench.types import RunStatus
from panobench.writing import is_disk_full

DISK_FULL = 75


def work(job: Path, out: Path) -> int:
    """Run the cell described in ``job``; returns the exit code."""
    values = json.loads(job.read_text(encoding="utf-8"))
    cell = Cell.from_dict(values["cell"])
    entry = CellRecord.from_dict(values["entry"])
    try:
        try:
            execute(cell.request, out, cell=entry)
        except PanobenchError as error:
            if is_disk_full(error):
                return DISK_FULL
            # as in planning, missing or broken data prevent a run as a missing package does
            status = RunStatus.UNAVAILABLE if isinstance(error, InputError) else RunStatus(error.run_status)
            write_failure(out, cell.request, status, str(error), log=str(error), cell=entry)
    except OSError as error:
        if not is_disk_full(error):
            raise
        traceback.print_exc()
        return DISK_FULL
    return 0


if __name__ == "__main__":
    faulthandler.enable()
    sys.exit(work(Path(sys.argv[1]), Path(sys.argv[2])))

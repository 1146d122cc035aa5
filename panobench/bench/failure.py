"""Run folders for runs that left none of their own: killed, out of time or memory, or never able to start."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from panobench.bench.evaluate import NAMES
from panobench.bench.provenance import provenance
from panobench.bench.request import RunRequest
from panobench.bench.runfolder import FRAMES, LOG, RUN_JSON, SCHEMA, TRAJECTORY, PendingRun, write_frames, write_json
from panobench.metrics.base import PROTOCOL_VERSION
from panobench.types import RunStatus

#: Of each log that is kept.
MAX_LOG_BYTES = 1 << 20


def write_failure(
    out: Path,
    request: RunRequest,
    status: RunStatus,
    message: str,
    *,
    log: str = "",
    timing: dict[str, Any] | None = None,
    extra: dict[str, Any] | None = None,
) -> Path:
    """A complete run folder without results at ``out``."""
    with PendingRun(out) as pending:
        (pending.path / LOG).write_text(log + f"\n{status.value}: {message}\n", encoding="utf-8")
        (pending.path / TRAJECTORY).write_text("# time x y z qx qy qz qw (camera-to-world)\n", encoding="utf-8")
        write_frames(pending.path / FRAMES, [])
        document = {
            "schema": SCHEMA,
            "status": status.value,
            "message": " ".join(message.split()),
            "origin": "measured",
            "spec": {**request.to_dict(), "config": {}, "camera_model": None},
            "method": {"name": request.method},
            "protocol": PROTOCOL_VERSION,
            "metric": False,
            "metrics": {**dict.fromkeys(NAMES), "tracked": 0.0},
            "notes": {},
            "timing": {
                **dict.fromkeys(("fps", "tracking_fps", "latency_p50_s", "latency_p95_s", "wall_s", "peak_rss_bytes")),
                **(timing or {}),
            },
            "frames": {"given": 0, "planned": None, "tracked": 0, "held_out": 0},
            "keyframes": [],
            "depth": {"source": None, "oracle": False, "poses_given": False},
            "groundtruth": False,
            "extra": {},
            "provenance": {**provenance(), "dataset": {}, "command": shlex.join(request.command())},
            "map": None,
            **(extra or {}),
        }
        write_json(pending.path / RUN_JSON, document)
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

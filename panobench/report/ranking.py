"""Decide which runs count as failed, and which cells of a column are best and second best."""

from __future__ import annotations

from collections.abc import Sequence

from panobench.bench.records.statistics import RANKING_RULE as STATISTICS_RULE
from panobench.bench.run.evaluate import broken_limit
from panobench.metrics.base import FAILED_ATE_M, MIN_TRACKED
from panobench.report.model import Run

#: The rule that every report states.
RANKING_RULE = (
    f"A run counts as failed (“/”) when it did not end with status ok, tracked fewer than {MIN_TRACKED:.0%} of its "
    f"frames, or has an ATE above {FAILED_ATE_M:g} m (or breaks the limits of the protocol it was scored under). "
    f"{STATISTICS_RULE} Within a column the best value is bold and the second best underlined; equal printed values "
    "share the mark. Coverage, the share of frames tracked, stands beside every ATE. Published figures come from other "
    "hardware and sometimes other data: they are never ranked against runs made here."
)


def failure(run: Run) -> str | None:
    """None for a run that counts, else why it is shown as failed, in a few words.

    The limits are those of the standard protocol; under another one (its name has a "+") the status has judged.
    """
    if run.status != "ok":
        return run.status
    if "+" in run.protocol:
        return None
    broken = broken_limit(run.record.metrics)
    return broken.short if broken is not None else None


def ranks(texts: Sequence[str | None], values: Sequence[float | None], better: str) -> list[int | None]:
    """1 for the best, 2 for the second best printed value of a column, None elsewhere.

    Nothing is marked when fewer than two values compete. Values that print alike rank alike.
    """
    out: list[int | None] = [None] * len(values)
    present = [i for i, v in enumerate(values) if v is not None and texts[i] is not None]
    if better not in ("lower", "higher") or len(present) < 2:
        return out
    sign = 1.0 if better == "lower" else -1.0
    order: list[str] = []
    for i in sorted(present, key=lambda i: sign * float(values[i] or 0.0)):
        if texts[i] not in order:
            order.append(str(texts[i]))
        if order.index(str(texts[i])) < 2:
            out[i] = order.index(str(texts[i])) + 1
    return out

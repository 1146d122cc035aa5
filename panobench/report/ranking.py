"""Who counts as failed, how repeats become one number, and which cells are best and second best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from panobench.metrics.base import FAILED_ATE_M, MIN_TRACKED
from panobench.report.model import Run

RANKING_RULE = (
    f"A run counts as failed (“/”) when it did not end with status ok, tracked fewer than {MIN_TRACKED:.0%} of its "
    f"frames, or has an ATE above {FAILED_ATE_M:g} m. Repeats are joined by their median, a failed repeat counting as "
    "worse than any number: a cell is “/” when the median itself is a failure. Within a column the best value is bold "
    "and the second best underlined; equal printed values share the mark. A mean over sequences is given only to "
    "methods that succeeded on all of them; methods are ordered by sequences succeeded, then by that mean. "
    "Coverage, the share of frames tracked, stands beside every ATE. Published figures come from other hardware and "
    "sometimes other data: they are never ranked against runs made here."
)


@dataclass(frozen=True)
class Summary:
    """Repeats as one number: median, quartiles, 95% interval of the median, and counts. ``inf`` median: failed."""

    median: float
    low: float
    high: float
    interval: tuple[float, float] | None
    count: int
    failed: int

    @property
    def ok(self) -> bool:
        return math.isfinite(self.median)


def failure(run: Run) -> str | None:
    """None for a run that counts, else why it is shown as failed, in a few words."""
    if run.status != "ok":
        return run.status
    tracked = run.number("tracked")
    if tracked is not None and tracked < MIN_TRACKED:
        return f"tracked {tracked:.0%}"
    ate = run.number("ate_rmse_m")
    if ate is not None and ate > FAILED_ATE_M:
        return f"ATE over {FAILED_ATE_M:g} m"
    return None


def summarise(values: Sequence[float | None], failed: int, *, higher_is_better: bool = False) -> Summary | None:
    """Median, quartiles and interval of the numbers present, ``failed`` repeats counting as worst.

    None when there is nothing to say (no number and no failure).
    """
    good = [v for v in values if v is not None]
    if not good and not failed:
        return None
    worst = -math.inf if higher_is_better else math.inf
    everything = np.sort(np.array(good + [worst] * failed, dtype=np.float64))
    middle = [everything[(len(everything) - 1) // 2], everything[len(everything) // 2]]
    median = float(np.mean(middle)) if np.all(np.isfinite(middle)) else math.inf
    low, high = np.quantile(good, [0.25, 0.75]) if good else (math.nan, math.nan)
    interval = median_interval(good) if len(good) >= 3 and not failed else None
    return Summary(median, float(low), float(high), interval, len(good) + failed, failed)


def median_interval(values: Sequence[float], *, draws: int = 2000, seed: int = 0) -> tuple[float, float]:
    """Percentile-bootstrap 95% interval of the median (Efron and Tibshirani, 1993)."""
    data = np.asarray(values, dtype=np.float64)
    picks = np.random.default_rng(seed).integers(0, len(data), size=(draws, len(data)))
    low, high = np.quantile(np.median(data[picks], axis=1), [0.025, 0.975])
    return float(low), float(high)


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

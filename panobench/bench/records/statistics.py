"""Medians, intervals and paired tests over repeats and sequences. Everything is exact or seeded.

A failed run has no number. It counts as worse than any number (``inf`` where lower is better, ``-inf`` where higher is
better), never as missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.95
#: Differences with a smaller p value are marked as significant.
ALPHA = 0.05
_DRAWS = 4000

#: How tables are ordered and marked; shown in every report.
RANKING_RULE = (
    "Each cell is the median over its repeats, a failed repeat counting as worse than any number. Methods are ranked "
    "first by the number of sequences they succeed on, then by the geometric mean of their error (or the mean of their "
    "score) over the sequences all compared methods succeed on. Methods marked with a dagger differ from the best one "
    "significantly: exact two-sided Wilcoxon signed-rank test on the per-sequence medians, Holm-corrected, p < 0.05; "
    "with fewer than six sequences no difference can reach that."
)


@dataclass(frozen=True)
class Summary:
    """A summary of repeats: median, quartiles, 95% interval of the median (None under three numbers), and counts."""

    median: float
    low: float
    high: float
    interval: tuple[float, float] | None
    count: int
    failed: int


def summarise(values: Sequence[float | None], *, higher_is_better: bool = False, seed: int = 0) -> Summary | None:
    """Summarise repeats (None: a failure). The median is infinite if failures decide it. None without repeats."""
    if not values:
        return None
    worst = -math.inf if higher_is_better else math.inf
    good = np.array([v for v in values if v is not None], dtype=np.float64)
    everything = np.sort([worst if v is None else v for v in values])
    middle = everything[(len(everything) - 1) // 2], everything[len(everything) // 2]
    median = worst if worst in middle else float(np.mean(middle))
    low, high = np.quantile(good, [0.25, 0.75]) if len(good) else (math.nan, math.nan)
    failed = len(values) - len(good)
    interval = median_interval(good, seed=seed) if len(good) >= 3 and not failed else None
    return Summary(median, float(low), float(high), interval, len(values), failed)


def median_interval(values: Sequence[float] | NDArray[np.float64], *, seed: int = 0) -> tuple[float, float]:
    """Percentile-bootstrap interval of the median (Efron & Tibshirani 1993)."""
    from scipy.stats import bootstrap

    data = np.asarray(values, dtype=np.float64)
    found = bootstrap(
        (data,),
        np.median,
        n_resamples=_DRAWS,
        confidence_level=LEVEL,
        method="percentile",
        random_state=np.random.default_rng(seed),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def _percentiles(draws: NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.quantile(draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def signed_rank_p(a: Sequence[float], b: Sequence[float]) -> float:
    """Two-sided p of Wilcoxon's signed-rank test for paired values, exact for any ties (Wilcoxon 1945).

    Pairs without a difference (both failed included) are left out; a failure against a number is the largest
    difference there is. All 2^n sign patterns are counted by dynamic programming over the sum of ranks, because
    scipy.stats.wilcoxon is exact only without ties, and two failures always tie.
    """
    from scipy.stats import rankdata

    differences = np.array([_difference(x, y) for x, y in zip(a, b, strict=True)])
    differences = differences[differences != 0]
    n = len(differences)
    if n == 0:
        return 1.0
    doubled = np.rint(2 * rankdata(np.abs(differences))).astype(int)  # ties give half ranks
    total = int(doubled.sum())
    ways = np.zeros(total + 1)
    ways[0] = 1.0
    for rank in doubled:
        ways[rank:] = ways[rank:] + ways[: total + 1 - rank]
    observed = int(doubled[differences > 0].sum())
    extreme = min(observed, total - observed)
    return float(min(1.0, 2.0 * ways[: extreme + 1].sum() / 2.0**n))


def _difference(x: float, y: float) -> float:
    return 0.0 if x == y else x - y


def holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment of several p values (Holm 1979)."""
    order = np.argsort(p)
    adjusted = np.ones(len(p))
    largest = 0.0
    for k, i in enumerate(order):
        largest = max(largest, (len(p) - k) * p[i])
        adjusted[i] = min(1.0, largest)
    return [float(v) for v in adjusted]


@dataclass(frozen=True)
class Ranked:
    """A method's place in the order: sequences it succeeded on, mean over the common ones, p value against the best."""

    name: str
    succeeded: int
    mean: float | None
    p: float | None

    @property
    def differs(self) -> bool:
        """Whether it differs significantly from the best."""
        return self.p is not None and self.p < ALPHA


def rank(table: dict[str, Sequence[float | None]], *, higher_is_better: bool = False) -> list[Ranked]:
    """Methods in order, from the per-sequence medians (None: failed) in the same order of sequences for all.

    The mean is geometric for errors (it must not be ruled by the hardest sequence), arithmetic for scores, over the
    sequences on which all methods succeed that succeed anywhere.
    """
    alive = {name for name, values in table.items() if any(v is not None for v in values)}
    length = len(next(iter(table.values()), ()))
    common = [i for i in range(length) if all(table[name][i] is not None for name in alive)]
    rows = []
    for name, values in table.items():
        numbers = [float(values[i]) for i in common if values[i] is not None] if name in alive else []  # type: ignore[arg-type]
        rows.append(
            (name, sum(v is not None for v in values), sequence_mean(numbers, higher_is_better=higher_is_better))
        )
    worst = math.inf
    sign = -1 if higher_is_better else 1
    rows.sort(key=lambda r: (-r[1], worst if r[2] is None else sign * r[2]))
    if not rows:
        return []
    best = _numbers(table[rows[0][0]], higher_is_better)
    p = holm([signed_rank_p(_numbers(table[name], higher_is_better), best) for name, _, _ in rows[1:]])
    return [Ranked(name, n, mean, None if k == 0 else p[k - 1]) for k, (name, n, mean) in enumerate(rows)]


def sequence_mean(values: Sequence[float], *, higher_is_better: bool = False) -> float | None:
    """The mean over sequences: geometric for errors above zero, else arithmetic; None without values."""
    if not values:
        return None
    if higher_is_better or min(values) <= 0:
        return float(np.mean(values))
    return float(np.exp(np.mean(np.log(values))))


def _numbers(values: Sequence[float | None], higher_is_better: bool) -> list[float]:
    worst = -math.inf if higher_is_better else math.inf
    return [worst if v is None else float(v) for v in values]


@dataclass(frozen=True)
class Change:
    """A change from a base to a new version: its estimate, 95% interval (None: too little data), and sequences used."""

    value: float
    interval: tuple[float, float] | None
    sequences: int

    def beyond_noise(self) -> bool:
        """Whether the interval excludes zero; True without an interval, as there is nothing to judge noise by."""
        return self.interval is None or self.interval[0] > 0 or self.interval[1] < 0


def change(
    base: Sequence[Sequence[float]], new: Sequence[Sequence[float]], *, relative: bool, seed: int = 0
) -> Change | None:
    """Mean change over sequences of the median over repeats; relative: geometric mean of the ratios, minus 1.

    base, new: per sequence its repeats' numbers, the same sequences in both. The interval is a bootstrap over
    sequences and, within each, over repeats; with one sequence and one repeat there is none. None without data, or
    for ratios of numbers that are not positive.
    """
    pairs = [(np.asarray(b, float), np.asarray(n, float)) for b, n in zip(base, new, strict=True) if len(b) and len(n)]
    if not pairs or (relative and any((x <= 0).any() for pair in pairs for x in pair)):
        return None
    steps = np.array([_step(np.median(b), np.median(n), relative) for b, n in pairs])
    rng = np.random.default_rng(seed)
    interval = None
    if len(pairs) > 1 or min(len(x) for x in pairs[0]) > 1:
        draws = np.empty((_DRAWS, len(pairs)))
        for i, (b, n) in enumerate(pairs):
            draws[:, i] = _step(_resampled(b, rng), _resampled(n, rng), relative)
        chosen = rng.integers(0, len(pairs), size=draws.shape)
        means = np.take_along_axis(draws, chosen, axis=1).mean(axis=1)
        low, high = _percentiles(means)
        interval = (_unstep(low, relative), _unstep(high, relative))
    return Change(_unstep(float(steps.mean()), relative), interval, len(pairs))


def _resampled(values: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Medians of resampled repeats, (_DRAWS,)."""
    return np.asarray(np.median(values[rng.integers(0, len(values), size=(_DRAWS, len(values)))], axis=1))


def _step(base: NDArray[np.float64] | float, new: NDArray[np.float64] | float, relative: bool) -> NDArray[np.float64]:
    return np.asarray(np.log(new) - np.log(base) if relative else np.subtract(new, base))


def _unstep(value: float, relative: bool) -> float:
    return math.expm1(value) if relative else value

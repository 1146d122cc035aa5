"""Intervals cover, tests are exact, failures count as worst."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from panobench.bench.records.statistics import change, holm, median_interval, rank, signed_rank_p, summarise


def test_summary_of_repeats() -> None:
    s = summarise([3.0, 1.0, 2.0, 4.0, 100.0])
    assert s is not None
    assert (s.median, s.low, s.high, s.count, s.failed) == (3.0, 2.0, 4.0, 5, 0)
    assert s.interval is not None
    assert s.interval[0] <= 3.0 <= s.interval[1]
    assert summarise([]) is None


def test_failed_repeats_are_worse_than_any_number() -> None:
    one = summarise([1.0, 2.0, None])
    assert one is not None
    assert (one.median, one.failed, one.interval) == (2.0, 1, None)
    two = summarise([1.0, None, None])
    assert two is not None
    assert two.median == math.inf
    half = summarise([1.0, 2.0, None, None])
    assert half is not None
    assert half.median == math.inf
    high = summarise([30.0, 20.0, None], higher_is_better=True)
    assert high is not None
    assert high.median == 20.0
    lost = summarise([None], higher_is_better=True)
    assert lost is not None
    assert lost.median == -math.inf


def test_median_interval_is_reproducible_and_covers() -> None:
    rng = np.random.default_rng(0)
    assert median_interval([1.0, 2.0, 3.0]) == median_interval([1.0, 2.0, 3.0])
    hits = 0
    for _ in range(100):
        low, high = median_interval(rng.normal(size=25))
        hits += low <= 0 <= high
    assert hits >= 88  # nominal 95; the percentile bootstrap of a median is a little short


def brute_p(a: list[float], b: list[float]) -> float:
    """All sign patterns, one by one."""
    d = np.array([x - y for x, y in zip(a, b) if x != y])
    ranks = stats.rankdata(np.abs(d))
    observed = ranks[d > 0].sum()
    total = ranks.sum()
    extreme = min(observed, total - observed)
    sums = [sum(r for r, s in zip(ranks, signs) if s) for signs in itertools.product([0, 1], repeat=len(d))]
    return min(1.0, 2 * float(np.mean(np.array(sums) <= extreme + 1e-9)))


@pytest.mark.parametrize("seed", range(10))
def test_signed_rank_is_exact_with_and_without_ties(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 9)).tolist()
    assert signed_rank_p(a, b) == pytest.approx(stats.wilcoxon(a, b, method="exact").pvalue)
    a, b = rng.integers(0, 4, size=(2, 9)).astype(float).tolist()
    assert signed_rank_p(a, b) == pytest.approx(brute_p(a, b))
    assert signed_rank_p(a, b) == signed_rank_p(b, a)


def test_signed_rank_with_failures() -> None:
    inf = math.inf
    assert signed_rank_p([inf] * 3, [inf] * 3) == 1.0
    assert signed_rank_p([inf] * 6, [1.0] * 6) == pytest.approx(2 / 64)
    assert signed_rank_p([inf, 1, 1, 1, 1, 1], [2.0] * 6) == pytest.approx(brute_p([100, 1, 1, 1, 1, 1], [2.0] * 6))
    assert signed_rank_p([], []) == 1.0
    assert signed_rank_p([1.0] * 5, [2.0] * 5) > 0.05  # five sequences cannot be enough


def test_holm() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


def test_ranking_counts_coverage_before_error() -> None:
    table = {
        "fragile": [0.001, 0.001, None],
        "steady": [0.01, 0.01, 0.01],
        "best": [0.005, 0.01, 0.004],
        "dead": [None, None, None],
    }
    ranked = rank(table)
    assert [r.name for r in ranked] == ["best", "steady", "fragile", "dead"]
    assert [r.succeeded for r in ranked] == [3, 3, 2, 0]
    # over the two sequences on which all that live succeed
    assert ranked[1].mean == pytest.approx(0.01)
    assert ranked[0].mean == pytest.approx(math.sqrt(0.005 * 0.01))
    assert ranked[0].p is None
    assert not any(r.differs for r in ranked)  # three sequences prove nothing


def test_ranking_marks_significant_differences() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0.01, 0.1, 10)
    ranked = rank({"a": base.tolist(), "b": (2 * base).tolist(), "c": (base * rng.permuted([0.99, 1.01] * 5)).tolist()})
    marks = {r.name: r.differs for r in ranked}
    assert marks["b"]
    assert sum(marks.values()) == 1
    higher = rank({"x": [30.0, 31.0], "y": [32.0, 33.0]}, higher_is_better=True)
    assert [r.name for r in higher] == ["y", "x"]
    assert rank({}) == []


def test_change_of_ratios_and_differences() -> None:
    found = change([[1.0], [2.0]], [[1.1], [2.2]], relative=True)
    assert found is not None
    assert found.value == pytest.approx(0.1)
    assert found.sequences == 2
    assert found.beyond_noise()
    absolute = change([[30.0], [31.0]], [[29.0], [31.5]], relative=False)
    assert absolute is not None
    assert absolute.value == pytest.approx(-0.25)
    assert not absolute.beyond_noise()
    assert change([[0.0]], [[1.0]], relative=True) is None
    assert change([[], []], [[1.0], []], relative=False) is None


def test_change_of_single_numbers_has_no_interval() -> None:
    found = change([[2.0]], [[3.0]], relative=True)
    assert found is not None
    assert found.interval is None
    assert found.beyond_noise()


def test_change_between_noisy_repeats_is_not_beyond_noise() -> None:
    rng = np.random.default_rng(3)
    alarms = 0
    for k in range(60):
        base, new = rng.lognormal(0, 0.2, size=(2, 4, 5))
        found = change(base.tolist(), new.tolist(), relative=True, seed=k)
        assert found is not None
        alarms += found.beyond_noise()
    assert alarms <= 9  # nominal 3 of 60; few sequences make the bootstrap optimistic
    worse = change(base.tolist(), (2 * base).tolist(), relative=True)
    assert worse is not None
    assert worse.beyond_noise()

"""Short campaigns of every fuzzing target, and every input that ever crashed one."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaign import Campaign, with_random
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutate import change, damaged
from targets import TARGETS, material

FUZZ = Path(__file__).resolve().parents[2] / "fuzz"
REGRESSIONS = sorted(p for p in (FUZZ / "regressions").glob("*/*") if p.is_file())
INPUTS = 60


@pytest.mark.parametrize("name", TARGETS)
def test_documents_are_read_and_damage_is_refused_cleanly(name: str, tmp_path: Path) -> None:
    run = TARGETS[name].runner(tmp_path)
    documents = material(name).documents
    assert sum(run(d) == "" for d in documents) >= len(documents) // 2, [run(d) for d in documents]
    campaign = Campaign(name, run, tmp_path / "crashes", seconds=10.0)
    with_random(campaign, INPUTS if name != "report-html" else 8, seed=7)
    assert campaign.found == {}
    assert campaign.refused > 0


@pytest.mark.parametrize("path", REGRESSIONS, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_what_crashed_a_parser_once_does_not_again(path: Path, tmp_path: Path) -> None:
    TARGETS[path.parent.name].runner(tmp_path)(path.read_bytes())


@pytest.mark.parametrize("name", ["tum", "ply", "kalibr", "run-json"])
def test_hypothesis_finds_no_crash_either(name: str, tmp_path: Path) -> None:
    run, start = TARGETS[name].runner(tmp_path), material(name)

    @settings(max_examples=60, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.integers(0, 99), st.lists(st.integers(0, (1 << 51) - 1), min_size=1, max_size=5))
    def check(document: int, numbers: list[int]) -> None:
        run(damaged(start, document, map(change, numbers)))

    check()


def test_a_campaign_notices_crashes_and_slow_inputs(tmp_path: Path) -> None:
    def run(data: bytes) -> str:
        if data == b"crash":
            raise KeyError("x")
        while data == b"hang":
            pass
        return "no"

    import signal

    from campaign import TooSlow

    def late(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, late)
    try:
        campaign = Campaign("demo", run, tmp_path, seconds=0.05)
        for data in (b"crash", b"fine", b"crash", b"hang"):
            campaign.feed(data)
    finally:
        signal.signal(signal.SIGPROF, before)
    summary = campaign.summary(1.0)
    assert (summary["inputs"], summary["refused"], summary["crashes"]) == (4, 1, 3)
    assert sorted(where.split()[0] for where in campaign.found) == ["KeyError", "TooSlow"]
    assert sorted(p.suffix for p in (tmp_path / "demo").iterdir()) == [".input", ".input", ".txt", ".txt"]

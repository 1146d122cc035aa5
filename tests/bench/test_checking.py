"""Second opinions on runs: which there is, what it sees, and that it never changes the run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.record import read_record
from panobench.bench.run.checking import Backwards, check_estimate, chosen_check
from panobench.bench.run.observer import Observer
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.testing.sequences import TinySequence
from panobench.types import Trajectory
from panobench.verdict.assess import BACKWARDS

TINY = RunRequest(method="sparse", sequence="tiny", width=256, max_frames=24)


@pytest.mark.parametrize(
    ("method", "check", "truth", "expected"),
    [
        ("panogs", "auto", False, "sparse"),
        ("panogs", "auto", True, None),
        ("sparse", "auto", False, BACKWARDS),
        ("panogs", "none", False, None),
        ("panogs", "direct", True, "direct"),
        ("direct", "direct", True, BACKWARDS),
    ],
)
def test_the_check_follows_the_data_unless_it_is_named(
    method: str, check: str, truth: bool, expected: str | None
) -> None:
    assert chosen_check(RunRequest(method=method, check=check), groundtruth=truth) == expected


def test_reversed_frames_have_increasing_times_and_come_back_forwards() -> None:
    sequence = TinySequence(n=6)
    backwards = Backwards(sequence, 5)
    assert len(backwards) == 5
    assert (np.diff(backwards.times) > 0).all()
    np.testing.assert_array_equal(backwards.image(0), sequence.image(4))
    T = np.stack([np.eye(4)] * 3)
    T[:, 0, 3] = [4.0, 2.0, 1.0]  # of frames 4, 2 and 1
    found = backwards.forwards(Trajectory(backwards.times[[0, 2, 3]], T))
    np.testing.assert_allclose(found.times, np.asarray(sequence.times)[[1, 2, 4]])
    assert found.positions[:, 0].tolist() == [1.0, 2.0, 4.0]


@pytest.mark.slow
@pytest.mark.parametrize("check", ["backwards", "direct"])
def test_a_right_run_is_confirmed(check: str, tmp_path: Path) -> None:
    record = read_record(execute(RunRequest(**{**TINY.to_dict(), "check": check}), tmp_path / "run"))
    assert record.verdict is not None
    assert record.verdict.check == check
    assert record.verdict.word == "trusted"
    assert any(e["name"] == f"check by {check}" and e["trust"] > 0.5 for e in record.verdict.evidence)
    assert [p.name for p in (tmp_path / "run").iterdir() if p.name.startswith(("check-", "work-"))] == []


def test_a_check_that_cannot_run_is_no_evidence(tmp_path: Path) -> None:
    said: list[str] = []
    assert check_estimate(TINY, "no-such-method", 5, tmp_path, said.append, Observer()) is None
    assert "no-such-method" in said[0]


def test_every_run_has_a_verdict_and_truth_needs_no_check(tmp_path: Path) -> None:
    record = read_record(execute(TINY, tmp_path / "run"))
    assert record.verdict is not None
    assert record.verdict.check is None
    assert record.verdict.word in ("trusted", "doubtful", "failed")
    assert 0.0 <= record.verdict.confidence <= 1.0

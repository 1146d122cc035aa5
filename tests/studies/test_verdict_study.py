"""The verdict study: its curve, and a small run of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from panobench.studies import verdict
from panobench.studies.base import StudyRequest


def judged(error: float | None, confidence: float, word: str = "trusted") -> verdict.Judged:
    return verdict.Judged("run", "panogs", "", error, word, confidence, "")


def test_right_and_wrong_leave_a_gap_between_them() -> None:
    assert judged(0.004, 1.0).right
    assert not judged(0.01, 1.0).right
    assert not judged(0.01, 1.0).wrong
    assert judged(0.03, 1.0).wrong
    assert judged(None, 1.0).wrong


def test_the_curve_goes_from_nothing_to_everything() -> None:
    points = verdict.curve([judged(0.001, 0.9), judged(0.001, 0.6), judged(0.1, 0.3), judged(None, 0.7)])
    assert points[0] == (0.0, 0.0, 0.0)
    assert points[-1][1:] == (1.0, 1.0)
    at = {round(t, 2): (doubted, caught) for t, doubted, caught in points}
    assert at[0.6] == (0.0, 0.5)
    assert at[0.9] == (0.5, 1.0)


@pytest.mark.slow
def test_a_small_study_has_a_row_per_method_and_disturbance(tmp_path: Path) -> None:
    options = {"methods": "sparse", "disturbances": ",:black=6", "sequences": "tiny", "max_frames": "16"}
    result = verdict.run(StudyRequest(tmp_path, quick=True, options=options))
    assert [row["Runs of"] for row in result.tables["verdict"]] == ["all", "sparse"]
    assert result.tables["verdict"][0]["Runs"] == len(result.tables["verdict-disturbances"])
    assert result.figures["curve"]["data"]

"""The study of length: what it reads from a run, piece by piece."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from panobench.errors import UsageError
from panobench.geometry import make_pose
from panobench.studies import length
from panobench.studies.base import StudyRequest
from panobench.types import Trajectory

FRAMES = 100


def walk(steps: np.ndarray) -> Trajectory:
    """Along a bow, with steps (N,) of these lengths."""
    way = np.cumsum(steps)
    positions = np.stack([way, 0 * way, 0.1 * way**2 / way[-1]], axis=1)
    return Trajectory(np.arange(len(steps)) / 10, make_pose(np.tile(np.eye(3), (len(steps), 1, 1)), positions))


def run(estimate: Trajectory, truth: Trajectory | None) -> Any:
    tracked = np.isin(np.arange(FRAMES) / 10, estimate.times)
    frames = {
        "time": np.arange(FRAMES) / 10,
        "tracked": tracked.astype(float),
        "latency_s": 0.01 * np.where(np.arange(FRAMES) < 75, 1.0, 3.0),
        "memory_mib": 100.0 + np.arange(FRAMES),
    }
    return SimpleNamespace(frames=frames, trajectory=estimate, groundtruth=truth)


def test_each_piece_has_its_time_and_memory_and_the_error_until_there() -> None:
    truth = walk(np.full(FRAMES, 0.1))
    shrinking = walk(3.0 * np.where(np.arange(FRAMES) < 50, 0.1, 0.08))  # another unit, and short after half the way
    found = length.reached(run(shrinking.select(np.arange(90)), truth), pieces=4, window=10)
    assert [p.frames for p in found] == [25, 50, 75, 100]
    assert [p.path for p in found] == pytest.approx([0.1 * n for n in (24, 49, 74, 99)], rel=0.02)
    assert [p.latency for p in found] == pytest.approx([0.01, 0.01, 0.01, 0.03])
    assert [p.memory for p in found] == [124, 149, 174, 199]
    assert [p.tracked for p in found] == pytest.approx([1, 1, 1, 0.6])
    assert found[1].scale == pytest.approx(1.0, abs=0.02)
    assert found[2].scale == pytest.approx(0.8, abs=0.03)
    errors = [p.ate or 0.0 for p in found]
    assert errors[0] < 0.02
    assert errors[2] > 0.05
    assert errors[3] > errors[2]


def test_without_truth_there_are_time_and_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def run_cells(study: StudyRequest, name: str, cells: Any) -> dict[str, Any]:
        asked.extend(cells)
        return {c.identity: SimpleNamespace(status="ok", folder=Path(c.request.method)) for c in asked}

    answer = run(walk(np.full(FRAMES, 0.1)), None)
    monkeypatch.setattr(length, "run_cells", run_cells)
    monkeypatch.setattr(length, "Run", lambda folder: answer)
    monkeypatch.setattr(length, "reasons", lambda results, cells: [])
    result = length.run(StudyRequest(tmp_path, options={"methods": "sparse,panogs:fast", "pieces": "5"}))
    assert [(c.request.method, c.request.preset) for c in asked] == [("sparse", None), ("panogs", "fast")]
    assert set(result.figures) == {"time", "memory"}
    assert result.figures["memory"]["data"][1]["x"] == [20, 40, 60, 80, 100]
    assert len(result.tables["length"]) == 10
    assert result.tables["length"][0]["ATE [mm]"] is None
    growth = result.tables["growth"][1]
    assert growth["Run"] == "panogs fast"
    assert growth["Time per frame, times ↓"] == pytest.approx(3.0)
    assert growth["Memory per 100 frames [MiB] ↓"] == pytest.approx(100.0)


@pytest.mark.parametrize("name", ["pieces", "window"])
def test_nothing_to_look_at_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=f"study option {name}: must be at least 1"):
        length.run(StudyRequest(tmp_path, options={name: "0"}))

"""The convergence-basin study on a room small enough for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.errors import UsageError
from panobench.geometry import make_pose, so3_exp
from panobench.studies import basin
from panobench.studies.base import StudyRequest

SMALL = {
    "sequence": "tiny", "width": "64", "fov": "120,360", "pinhole": "false", "grid": "5", "rings": "0.05,0.5",
    "directions": "2", "map_views": "2", "map_every": "2", "map_iterations": "10", "frame": "2",
}  # fmt: skip


def test_map_frames_surround_the_frame_and_leave_it_out() -> None:
    options = basin.BasinOptions(frame=3, map_views=3, map_every=2)
    assert basin.map_frames(options, 40) == [5, 1, 7]
    assert basin.map_frames(options, 6) == [5, 1]
    with pytest.raises(UsageError, match="2 frames"):
        basin.map_frames(options, 2)
    with pytest.raises(UsageError, match="grid"):
        basin.BasinOptions(grid=1)


def test_moves_are_along_the_cameras_own_axes() -> None:
    from panobench.studies.landscape import moved

    T = make_pose(so3_exp(np.array([0.0, np.pi / 2, 0.0])), np.array([1.0, 2.0, 3.0]))
    assert np.allclose(moved(T, 0.0, 0.5)[:3, 3], [1.5, 2.0, 3.0])  # forward is the world's x after a quarter turn
    assert np.allclose(moved(T, 0.5, 0.0)[:3, 3], [1.0, 2.0, 2.5])


def test_a_small_basin_is_lowest_in_the_middle_and_is_not_measured_twice(tmp_path: Path) -> None:
    lines: list[str] = []
    request = StudyRequest(tmp_path, options=dict(SMALL), say=lines.append)
    result = basin.run(request)
    assert [row["FoV"] for row in result.tables["basin"]] == ["120°", "360°"]
    for name in ("loss-120", "loss-360"):
        loss = np.array(result.figures[name]["data"][0]["z"])
        assert np.unravel_index(loss.argmin(), loss.shape) == (2, 2)
    around = result.tables["conditioning"]
    assert 1 <= around[1]["Condition number ↓"] < around[0]["Condition number ↓"]
    assert result.tables["basin"][1]["0.05 z [%] ↑"] == 100
    assert sum("field of view" in line for line in lines) == 2
    lines.clear()
    assert basin.run(request) == result
    assert lines == []
    damaged = next((tmp_path / "basin").iterdir())
    damaged.write_text("{")
    assert basin.run(request) == result
    assert sum("field of view" in line for line in lines) == 1

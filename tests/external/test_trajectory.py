"""Tests of reading the trajectories that programs write."""

from pathlib import Path

import numpy as np
import pytest

from panobench.external import TrajectoryFormat, read_answer


@pytest.mark.parametrize("start", [0.0, 1000.0, 1.7e9])
@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize(
    ("kind", "unit", "row"),
    [
        ("tum", 1.0, "{:.6f} 1 2 3 0 0 0 1"),
        ("tum-ns", 1e-9, "{:.0f} 1 2 3 0 0 0 1"),
        ("euroc", 1e-9, "{:.0f},1,2,3,1,0,0,0,"),
    ],
)
def test_times_are_in_the_kinds_unit_however_few_or_large(
    tmp_path: Path, kind: str, unit: float, row: str, n: int, start: float
) -> None:
    # A file of one pose, or of frame numbers, does not show its unit: the program's format says it.
    times = start + np.arange(4) * 0.05
    path = tmp_path / "answer.txt"
    path.write_text("\n".join(row.format(t / unit) for t in times[:n]) + "\n")

    found = read_answer(path, TrajectoryFormat(kind), times)  # type: ignore[arg-type]

    assert found.times.tolist() == times[:n].tolist()
    np.testing.assert_allclose(found.T_wc[:, :3, 3], np.tile([1.0, 2.0, 3.0], (n, 1)))


def test_frame_numbers_as_times_stay_seconds(tmp_path: Path) -> None:
    times = np.arange(5) * 0.1
    path = tmp_path / "answer.txt"
    path.write_text("".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(0, 5, 2)))

    found = read_answer(path, TrajectoryFormat("tum", index_rate=1.0), times)

    assert found.times.tolist() == times[::2].tolist()

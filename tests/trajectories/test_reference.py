"""Any trajectory as a sequence's ground truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.record import read_record
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.bench.run.setup import open_input
from panobench.datasets.files.trajectory_io import read_tum, write_tum
from panobench.errors import InputError, UsageError
from panobench.geometry import Sim3, so3_exp
from panobench.testing import TinySequence
from panobench.trajectories.matching import Frames
from panobench.trajectories.reference import at_times, read_reference
from panobench.types import Trajectory


def truth(n: int = 8) -> Trajectory:
    found = TinySequence(n=n).groundtruth
    assert found is not None
    return found


def test_poses_between_frames_are_interpolated_within_a_tenth_of_a_second() -> None:
    T = truth()
    shifted = Trajectory(T.times + 0.02, T.T_wc)
    found = at_times(shifted, T.times)
    assert len(found) == 7  # the first frame lies before the first pose
    assert np.isin(found.times, T.times).all()
    sparse = T.select(np.array([0, 1, 5, 7]))
    step = T.times[1]
    found = at_times(Trajectory(sparse.times + 1e-4, sparse.T_wc), T.times)
    assert len(found) == (4 if 4 * step > 0.1 else 8)


@pytest.mark.usefixtures("fake_plugin")
def test_a_run_is_judged_by_the_file(tmp_path: Path) -> None:
    """Here for a dataset that has a truth of its own, turned and scaled: the file counts."""
    request = RunRequest(method="fake-still", dataset="tiny", width=128)
    own = open_input(request).groundtruth
    assert own is not None
    other = Sim3(2.0, so3_exp([0.3, 0, 0]), np.zeros(3)).apply_poses(own.T_wc)
    write_tum(tmp_path / "reference.tum", Trajectory(own.times, other))
    request = RunRequest(method="fake-still", dataset="tiny", width=128, groundtruth=str(tmp_path / "reference.tum"))
    sequence = open_input(request)
    assert sequence.groundtruth is not None
    assert sequence.groundtruth.T_wc == pytest.approx(other)
    assert sequence.novel_views() == []
    folder = execute(request, tmp_path / "run")
    assert read_tum(folder / "groundtruth.tum").T_wc == pytest.approx(other)
    record = read_record(folder)
    assert record.provenance.dataset["groundtruth"]["file"] == "reference.tum"
    assert f"--groundtruth {tmp_path / 'reference.tum'}" in record.provenance.command
    # the other axes of a view turn with it
    view = open_input(RunRequest(method="fake-still", dataset="tiny", width=64, camera="pinhole:right",
                                 groundtruth=str(tmp_path / "reference.tum")))  # fmt: skip
    assert view.groundtruth is not None
    assert view.groundtruth.positions == pytest.approx(other[:, :3, 3])
    assert view.groundtruth.T_wc[:, :3, 2] == pytest.approx(other[:, :3, 0])


def test_a_reference_that_does_not_fit_is_explained(tmp_path: Path) -> None:
    T, frames = truth(), Frames.of(TinySequence(n=8))
    path = tmp_path / "reference.tum"
    write_tum(path, Trajectory(T.times * 1e3, T.T_wc))
    with pytest.raises(InputError, match="they look like milliseconds"):
        read_reference(path, frames)
    assert len(read_reference(path, frames, unit="ms").trajectory) == 8
    write_tum(path, T)
    with pytest.raises(UsageError, match="--groundtruth-scale km: expected metres or none"):
        read_reference(path, frames, scale="km")
    assert read_reference(path, frames).scaled
    assert not read_reference(path, frames, scale="none").scaled

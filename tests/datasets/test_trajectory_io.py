from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_samples import poses

from panobench.datasets.files.trajectory_io import read_euroc_csv, read_kitti, read_tum, write_tum
from panobench.datasets.files.trajectory_match import interpolate_poses, match_to_times
from panobench.errors import DatasetError
from panobench.geometry import make_pose, quaternion_from_matrix, so3_exp
from panobench.types import Trajectory


def test_tum_round_trip(tmp_path: Path) -> None:
    trajectory = Trajectory(np.array([0.0, 1 / 15, 1700000000.25]), poses(3))
    write_tum(tmp_path / "t.tum", trajectory)
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(back.times, trajectory.times, atol=1e-9, rtol=0)
    np.testing.assert_allclose(back.T_wc, trajectory.T_wc, atol=1e-11)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 0 0 0 0 0 0", "7 values, expected 8"),
        ("1 0 0 0 0 0 0 1 9", "9 values, expected 8"),
        ("1 0 0 x 0 0 0 1", "'x' is not a number"),
        ("nan 0 0 0 0 0 0 1", "'nan' is not a finite"),
        ("inf 0 0 0 0 0 0 1", "'inf' is not a finite"),
        ("0 0 0 1 0 0 0 1", "not later"),
        ("-1 0 0 0 0 0 0 1", "not later"),
        ("1 0 0 0 0 0 0 2", "norm 2"),
    ],
)
def test_tum_errors_name_file_and_line(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"# comment\n0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(DatasetError, match=r"t\.tum:3: ") as caught:
        read_tum(path)
    assert message in str(caught.value)


def test_missing_empty_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="missing"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "t.tum").write_text("# nothing\n")
    with pytest.raises(DatasetError, match="no pose"):
        read_tum(tmp_path / "t.tum")
    (tmp_path / "t.tum").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(DatasetError, match="not UTF-8"):
        read_tum(tmp_path / "t.tum")


def test_kitti(tmp_path: Path) -> None:
    T = poses(3)
    path = tmp_path / "k.txt"
    path.write_text("\n".join(" ".join(map(str, p[:3].ravel())) for p in T))
    np.testing.assert_allclose(read_kitti(path, [0.0, 1.0, 2.0]).T_wc, T, atol=1e-12)
    with pytest.raises(DatasetError, match="3 poses for 2 frames"):
        read_kitti(path, [0.0, 1.0])
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(DatasetError, match=r"k\.txt:2: the 3x3 part is not a rotation"):
        read_kitti(path, [0.0, 1.0])


def test_euroc_csv_has_the_real_part_first(tmp_path: Path) -> None:
    T = poses(2)
    w, x, y, z = quaternion_from_matrix(T[1, :3, :3])
    path = tmp_path / "data.csv"
    path.write_text(
        "#timestamp [ns], p_x, p_y, p_z, q_w, q_x, q_y, q_z, v\n1000000000,0,0,0,1,0,0,0,5\n"
        f"1500000000,{T[1, 0, 3]},{T[1, 1, 3]},{T[1, 2, 3]},{w},{x},{y},{z},5\n"
    )
    trajectory = read_euroc_csv(path)
    np.testing.assert_allclose(trajectory.times, [1.0, 1.5])
    np.testing.assert_allclose(trajectory.T_wc[1], T[1], atol=1e-9)


def test_interpolation_follows_a_constant_twist() -> None:
    times = np.linspace(0, 2, 5)
    exact = make_pose(so3_exp(times[:, None] * [[0.3, -0.8, 0.2]]), times[:, None] * [[1.0, 2.0, 3.0]])
    wanted = np.array([-0.1, 0.0, 0.33, 1.71, 2.0, 2.1])
    result = interpolate_poses(Trajectory(times, exact), wanted)
    np.testing.assert_array_equal(result.times, wanted[1:5])
    expected = make_pose(so3_exp(wanted[1:5, None] * [[0.3, -0.8, 0.2]]), wanted[1:5, None] * [[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(result.T_wc, expected, atol=1e-12)


def test_interpolation_does_not_bridge_gaps() -> None:
    trajectory = Trajectory(np.array([0.0, 0.1, 1.0, 1.1]), poses(4))
    result = interpolate_poses(trajectory, np.array([0.05, 0.1, 0.5, 1.0, 1.05]), max_gap=0.2)
    np.testing.assert_array_equal(result.times, [0.05, 0.1, 1.0, 1.05])


def test_matching_takes_the_nearest_once_and_stamps_it_exactly() -> None:
    trajectory = Trajectory(np.array([0.0, 0.1004, 0.2, 0.5]), poses(4))
    result = match_to_times(trajectory, np.array([0.0, 0.1, 0.1006, 0.3]), 1e-3)
    np.testing.assert_array_equal(result.times, [0.0, 0.1006])
    np.testing.assert_array_equal(result.T_wc, trajectory.T_wc[:2])

"""Tables whose columns stand in another order, or count time in another unit, than the usual one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_samples import poses

from panobench.datasets.files.columns import Columns, columns, is_header
from panobench.datasets.files.imu_table import read_imu_table
from panobench.datasets.files.trajectory_io import read_euroc_csv, read_pose_csv, read_tum, rows_from_poses, time_unit
from panobench.datasets.formats.synpano import read_pose_table
from panobench.errors import DatasetError
from panobench.external.imported import ImportOptions, read_imported
from panobench.trajectories.matching import Frames, place
from panobench.types import Trajectory

N = 12
TIMES = np.arange(N) / 15
TRUE = poses(N)
X, Y, Z, QX, QY, QZ, QW = rows_from_poses(TRUE).T
NS = np.rint(TIMES * 1e9)
V = np.full(N, 0.5)


def table(path: Path, header: str, *values: np.ndarray, separator: str = ",", form: str = "%.9f") -> Path:
    text = [separator.join(form % v if v % 1 else f"{v:.0f}" for v in row) for row in zip(*values)]
    path.write_text("\n".join([header, *text] if header else text) + "\n")
    return path


HEADERS = [
    ("ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw", (NS, X, Y, Z, QX, QY, QZ, QW)),
    ("timestamp, p_x, p_y, p_z, q_x, q_y, q_z, q_w, v_x, v_y, v_z", (NS, X, Y, Z, QX, QY, QZ, QW, V, V, V)),
    ("#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [],"
     " v_RS_R_x [m s^-1]", (NS, X, Y, Z, QW, QX, QY, QZ, V)),
    ("ts,tx,ty,tz,qx,qy,qz,qw", (TIMES, X, Y, Z, QX, QY, QZ, QW)),
    ("time_s,pos_x,pos_y,pos_z,quat_w,quat_x,quat_y,quat_z", (TIMES, X, Y, Z, QW, QX, QY, QZ)),
    ("qw,qx,qy,qz,x,y,z,t", (QW, QX, QY, QZ, X, Y, Z, TIMES)),
    ("Timestamp_ms,posX,posY,posZ,rotX,rotY,rotZ,rotW", (TIMES * 1e3, X, Y, Z, QX, QY, QZ, QW)),
    ("time [us],x,y,z,orientation.x,orientation.y,orientation.z,orientation.w",
     (TIMES * 1e6, X, Y, Z, QX, QY, QZ, QW)),
    ("%time,field.header.seq,field.header.stamp,field.pose.position.x,field.pose.position.y,field.pose.position.z,"
     "field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w",
     (NS + 5e9, V, NS, X, Y, Z, QX, QY, QZ, QW)),
    ("Time,header.stamp.secs,header.stamp.nsecs,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,"
     "pose.orientation.y,pose.orientation.z,pose.orientation.w",
     (TIMES + 9, np.floor(TIMES), NS - 1e9 * np.floor(TIMES), X, Y, Z, QX, QY, QZ, QW)),
]  # fmt: skip


@pytest.mark.parametrize(("header", "values"), HEADERS, ids=[h[:24] for h, _ in HEADERS])
@pytest.mark.parametrize("read", [read_pose_csv, read_euroc_csv, read_tum])
def test_a_header_says_which_column_is_what(header: str, values: tuple, read: object, tmp_path: Path) -> None:
    found = read(table(tmp_path / "t.csv", header, *values))  # type: ignore[operator]
    np.testing.assert_allclose(found.times, TIMES, atol=1e-6)
    np.testing.assert_allclose(found.T_wc, TRUE, atol=1e-8)


@pytest.mark.parametrize("separator", [" ", "\t", ";"])
def test_separators_other_than_commas(separator: str, tmp_path: Path) -> None:
    header = separator.join(["timestamp", "tx", "ty", "tz", "qw", "qx", "qy", "qz"])
    path = table(tmp_path / "t.txt", header, TIMES, X, Y, Z, QW, QX, QY, QZ, separator=separator)
    np.testing.assert_allclose(read_tum(path).T_wc, TRUE, atol=1e-8)
    if separator == ";":
        path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_allclose(read_pose_csv(path).T_wc, TRUE, atol=1e-8)


def test_without_a_header_the_times_tell_euroc_from_tum(tmp_path: Path) -> None:
    for values, scale in [
        ((NS, X, Y, Z, QW, QX, QY, QZ), 1.0),
        ((TIMES, X, Y, Z, QX, QY, QZ, QW), 1.0),
        ((TIMES * 1e6, X, Y, Z, QX, QY, QZ, QW), 1.0),
        ((1.7e12 + TIMES * 1e3, X, Y, Z, QX, QY, QZ, QW), 1.0),  # milliseconds with a date
    ]:
        found = read_pose_csv(table(tmp_path / "t.csv", "", *values))
        np.testing.assert_allclose(found.times - found.times[0], TIMES * scale, atol=1e-3)
        np.testing.assert_allclose(found.T_wc, TRUE, atol=1e-8)


def placed(path: Path, options: ImportOptions) -> Trajectory:
    return place(read_imported(path, options), Frames(TIMES), path).trajectory


def test_an_imported_table_is_matched_to_its_frames(tmp_path: Path) -> None:
    for header, values in HEADERS:
        found = placed(table(tmp_path / "t.csv", header, *values), ImportOptions())
        assert len(found) == N, header
    milliseconds = table(tmp_path / "t.tum", "", np.rint(TIMES * 1e3), X, Y, Z, QX, QY, QZ, QW, separator=" ")
    assert len(placed(milliseconds, ImportOptions(time_unit="ms"))) == N
    commas = table(tmp_path / "c.tum", "", TIMES, X, Y, Z, QX, QY, QZ, QW)
    assert len(placed(commas, ImportOptions("tum"))) == N


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time,x,y,z,roll,pitch,yaw,quality", "no quaternion"),
        ("index,x,y,z,qx,qy,qz,qw", "no time"),
        ("time,lat,lon,alt,qx,qy,qz,qw", "no position"),
    ],
)
def test_a_header_that_lacks_something_says_what(header: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=message):
        read_pose_csv(table(tmp_path / "t.csv", header, TIMES, X, Y, Z, QX, QY, QZ, QW))


def test_names_that_mean_something_else() -> None:
    assert columns(["v_x", "v_y", "v_z", "cov_x", "std_q_x", "twist.linear.x"]) == Columns()
    assert not is_header(["0.1", "a"])
    assert not is_header(["", "#"])


def test_units_of_time() -> None:
    for unit in (1e-9, 1e-6):
        assert time_unit(np.rint(TIMES / unit), 1.0) == unit
    assert time_unit(1.7e9 + TIMES, 1.0) == 1.0
    assert time_unit(TIMES, 1e-9) == 1.0
    assert time_unit(np.array([1.7e18]), 1.0) == 1e-9
    assert time_unit(np.array([0.0, 1 / 15, 1.7e9]), 1.0) == 1.0  # a long pause


@pytest.mark.parametrize(
    ("header", "order", "unit"),
    [
        ("", (0, 1, 2, 3, 4, 5, 6), 1.0),
        ("time,wx,wy,wz,ax,ay,az", (0, 1, 2, 3, 4, 5, 6), 1.0),
        ("timestamp,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z", (0, 4, 5, 6, 1, 2, 3), 1.0),
        ("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
         "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]", (0, 1, 2, 3, 4, 5, 6), 1e-9),
        ("angular_velocity.x,angular_velocity.y,angular_velocity.z,linear_acceleration.x,linear_acceleration.y,"
         "linear_acceleration.z,header.stamp", (1, 2, 3, 4, 5, 6, 0), 1e-9),
    ],
)  # fmt: skip
def test_inertial_samples_by_their_header(header: str, order: tuple, unit: float, tmp_path: Path) -> None:
    values = np.arange(70.0).reshape(10, 7)
    values[:, 0] = np.arange(10) * 0.005
    stored = values.copy()
    stored[:, 0] = np.rint(stored[:, 0] / unit) if unit < 1 else stored[:, 0]
    imu = read_imu_table(table(tmp_path / "imu.csv", header, *stored[:, order].T))
    np.testing.assert_allclose(imu.times, values[:, 0], atol=1e-9)
    np.testing.assert_allclose(imu.gyro, values[:, 1:4])
    np.testing.assert_allclose(imu.accel, values[:, 4:])
    with pytest.raises(DatasetError, match="names no time, angular rate"):
        read_imu_table(table(tmp_path / "bad.csv", "time,a,b,c,d,e,f", *values.T))


def test_a_scene_s_table_by_its_header(tmp_path: Path) -> None:
    names = [f"{i}.png" for i in range(N)]
    rows = [f"{i} {n} " + " ".join(map(str, r)) for i, (n, r) in enumerate(zip(names, zip(X, Y, Z, QW, QX, QY, QZ)))]
    path = tmp_path / "groundtruth.txt"
    path.write_text("\n".join(["frame_id image_name x y z qw qx qy qz", *rows]))
    np.testing.assert_allclose(read_pose_table(path).T_wc, TRUE, atol=1e-8)


@pytest.mark.parametrize("comment", ["# made by hand", "% made in Matlab", "// made in C", "%{ block"])
def test_comments_of_other_programs(comment: str, tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", f"{comment}\n% time x y z qx qy qz qw", TIMES, X, Y, Z, QX, QY, QZ, QW)
    np.testing.assert_allclose(read_pose_csv(path).T_wc, TRUE, atol=1e-8)


@pytest.mark.parametrize("header", ["", "time,tx,ty,tz,qx,qy,qz,qw,"])
def test_a_comma_at_the_end_of_each_row_is_no_column(header: str, tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", header, TIMES, X, Y, Z, QX, QY, QZ, QW)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line if line == header else f"{line}," for line in lines))
    np.testing.assert_allclose(read_pose_csv(path).T_wc, TRUE, atol=1e-8)


@pytest.mark.parametrize(
    ("names", "unit"),
    [("x [mm],y [mm],z [mm]", 1e-3), ("PosX(cm),PosY(cm),PosZ(cm)", 1e-2), ("x_mm,y_mm,z_mm", 1e-3), ("x,y,z", 1.0)],
)
def test_units_of_length_in_a_header(names: str, unit: float, tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", f"time,{names},qx,qy,qz,qw", TIMES, X / unit, Y / unit, Z / unit, QX, QY, QZ, QW)
    np.testing.assert_allclose(read_pose_csv(path).T_wc, TRUE, atol=1e-8)


@pytest.mark.parametrize(
    ("header", "gyro", "accel"),
    [
        ("time,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],acc_x [g],acc_y [g],acc_z [g]", np.pi / 180, 9.80665),
        ("time,gyro_x_dps,gyro_y_dps,gyro_z_dps,acc_x_mg,acc_y_mg,acc_z_mg", np.pi / 180, 9.80665e-3),
        ("time,wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]", 1.0, 1.0),
    ],
)
def test_units_of_inertial_samples(header: str, gyro: float, accel: float, tmp_path: Path) -> None:
    values = np.arange(1.0, 71.0).reshape(10, 7)
    values[:, 0] = np.arange(10) * 0.005
    imu = read_imu_table(table(tmp_path / "imu.csv", header, *values.T))
    np.testing.assert_allclose(imu.gyro, values[:, 1:4] * gyro)
    np.testing.assert_allclose(imu.accel, values[:, 4:] * accel)


def test_a_pose_that_is_there_twice_counts_once(tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", "", *(np.repeat(v, 2) for v in (TIMES, X, Y, Z, QX, QY, QZ, QW)))
    np.testing.assert_allclose(read_pose_csv(path).T_wc, TRUE, atol=1e-8)


def test_positions_without_rotations_are_said_to_be_such(tmp_path: Path) -> None:
    from panobench.trajectories.reading import read_poses

    with pytest.raises(DatasetError, match="the header names no quaternion"):
        read_poses(table(tmp_path / "t.csv", "time,x,y,z", TIMES, X, Y, Z))

"""TUM-VI, 360VO, 360Loc, OmniBlender and OB3D, each on a tiny sample written here."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import panorama, pose_row, poses, save

from panobench.cameras.calibration import write_calibration
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.datasets.formats.vo360 import left_to_right_handed
from panobench.datasets.open import open_dataset, open_sequence
from panobench.errors import CalibrationError, DatasetError
from panobench.geometry import invert_pose, make_pose, quaternion_from_matrix, so3_exp

BODY_T_CAM = make_pose(so3_exp([0.1, -0.2, 0.3]), [0.05, 0.01, -0.02])


# 360VO


def test_360vo_is_mirrored(tmp_path: Path) -> None:
    # A left-handed rig (x right, y up, z forward) that turns right about y and moves up.
    lines = []
    for i in range(3):
        save(tmp_path / f"seq0/images/{i:03d}.png", panorama(i))
        a = 0.1 * i
        lines.append(f"{i} {i:03d}.png 0 {0.5 * i} {i} 0 {np.sin(a / 2)} 0 {np.cos(a / 2)}")
    (tmp_path / "seq0/groundtruth.txt").write_text("\n".join(lines))
    truth = open_sequence("360vo", "seq0", tmp_path).groundtruth
    assert truth is not None
    T = truth.T_wc[2]
    np.testing.assert_allclose(T[:3, 3], [0, -1, 2])  # up is -y now
    np.testing.assert_allclose(T[:3, 2], [np.sin(0.2), 0, np.cos(0.2)], atol=1e-12)  # a right turn looks towards +x
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_mirroring_twice_is_nothing() -> None:
    T = poses(4)
    np.testing.assert_allclose(left_to_right_handed(left_to_right_handed(T)), T)


# 360Loc


def loc360(folder: Path, n: int = 3) -> np.ndarray:
    true = poses(n)
    for i in range(n):
        save(folder / f"image/{i:03d}.jpg", panorama(i))
    table = {f"{i:03d}.jpg": true[i].tolist() for i in reversed(range(n))}
    (folder / "camera_pose.json").write_text(json.dumps(table))
    return true


def test_360loc(tmp_path: Path) -> None:
    true = loc360(tmp_path / "atrium/mapping/daytime_360_0")
    loc360(tmp_path / "atrium/query_360/night_360_1")
    loc360(tmp_path / "atrium/query_pinhole/night_pinhole_1")
    dataset = open_dataset("360loc", tmp_path)
    assert dataset.sequences() == ["atrium/mapping/daytime_360_0", "atrium/query_360/night_360_1"]
    sequence = dataset.open()
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, true, atol=1e-12)
    assert np.abs(sequence.image(2).astype(int) - panorama(2)).mean() < 4
    assert open_sequence("360loc", None, tmp_path / "atrium/mapping/daytime_360_0").name == "daytime_360_0"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "expected image names"),
        ('{"009.jpg": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "image '009.jpg' is missing"),
        ('{"000.jpg": [[1,0,0],[0,1,0]]}', "the pose of '000.jpg' is no 4x4 matrix"),
        ('{"000.jpg": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "the pose of '000.jpg' is not a rigid motion"),
        ('{"000.jpg": [["a",0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "no 4x4 matrix of numbers"),
        ('{"000.jpg": [[1,0,0,NaN],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}', "NaN is not a number in JSON"),
    ],
)
def test_bad_360loc_poses(tmp_path: Path, content: str, message: str) -> None:
    loc360(tmp_path)
    (tmp_path / "camera_pose.json").write_text(content)
    with pytest.raises(DatasetError, match=r"camera_pose\.json") as caught:
        open_sequence("360loc", None, tmp_path)
    assert message in str(caught.value)


# OmniBlender and OB3D


def test_omniblender(tmp_path: Path) -> None:
    true = poses(3)
    frames = []
    for i in (2, 0, 1):
        save(tmp_path / f"barbershop/images/{i:02d}.png", panorama(i))
        stored = true[i].copy()
        stored[:3, :3] = true[i, :3, :3] @ np.diag([1.0, -1.0, -1.0])
        frames.append({"file_path": f"{i:02d}.png", "transform_matrix": stored.tolist()})
    path = tmp_path / "barbershop/transform.json"
    path.write_text(json.dumps({"indoor": True, "frames": frames}))
    sequence = open_sequence("omniblender", "barbershop", tmp_path)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, true, atol=1e-12)
    np.testing.assert_array_equal(sequence.image(1), panorama(1))
    for broken, message in [
        ({}, "expected 'frames'"),
        ({"frames": [{}]}, "frame 0: a frame has no 'file_path'"),
        ({"frames": [{"file_path": "9.png"}]}, "image '9.png' is missing"),
        ({"frames": [{"file_path": "00.png"}]}, "no 4x4 matrix"),
        ({"frames": []}, "empty"),
    ]:
        path.write_text(json.dumps(broken))
        with pytest.raises(DatasetError, match="barbershop") as caught:
            open_sequence("omniblender", "barbershop", tmp_path)
        assert message in str(caught.value)


def test_ob3d(tmp_path: Path) -> None:
    true = poses(3)
    folder = tmp_path / "classroom/Non-Egocentric"
    for i in range(3):
        save(folder / f"images/{i:05d}_rgb.png", panorama(i))
        T_cw = invert_pose(true[i])
        camera = [{"extrinsics": {"rotation": T_cw[:3, :3].tolist(), "translation": T_cw[:3, 3].tolist()}}]
        path = folder / f"cameras/{i:05d}_cam.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(camera))
    dataset = open_dataset("omniblender", tmp_path)
    assert dataset.sequences() == ["classroom/Non-Egocentric"]
    truth = dataset.open().groundtruth
    assert truth is not None
    np.testing.assert_allclose(truth.T_wc, true, atol=1e-12)
    path.write_text("[{}]")
    with pytest.raises(DatasetError, match=r"00002_cam\.json, frame 2: expected 'extrinsics'"):
        dataset.open()


# TUM-VI


def tum_vi(folder: Path, n: int = 4) -> tuple[np.ndarray, KannalaBrandtCamera]:
    """A sequence whose IMU moves steadily; returns the camera's poses at the images."""
    camera = KannalaBrandtCamera(64, 64, 24.0, 24.0, 32.0, 32.0, (0.01, 0.0, 0.0, 0.0))
    cam = folder / "mav0/cam0"
    start = 1_520_530_308_199_447_626
    rows = ["#timestamp [ns],filename"]
    for i in range(n):
        ns = start + i * 50_000_000
        save(cam / f"data/{ns}.png", np.full((64, 64), 1000 * i + 257, np.uint16))
        rows.append(f"{ns},{ns}.png")
    (cam / "data.csv").write_text("\n".join(rows))

    def body(t: float) -> np.ndarray:
        return make_pose(so3_exp([0.2 * t, 0.5 * t, 0.0]), [t, 0.3 * t, 0.0])

    truth = ["#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"]
    for k in range(-2, 40):
        T = body(k * 0.008)
        w, x, y, z = quaternion_from_matrix(T[:3, :3])
        truth.append(",".join(map(str, (start + k * 8_000_000, *T[:3, 3], w, x, y, z))))
    imu = ["#t,w,w,w,a,a,a", f"{start},1,2,3,4,5,6", f"{start + 5_000_000},1,2,3,4,5,6"]
    for name, lines in [("mocap0", truth), ("imu0", imu)]:
        (folder / f"mav0/{name}").mkdir()
        (folder / f"mav0/{name}/data.csv").write_text("\n".join(lines))
    calibration = folder / "dso/camchain.yaml"
    calibration.parent.mkdir()
    write_calibration(camera, calibration, "kalibr")
    text = calibration.read_text().rstrip() + f"\n  T_cam_imu: {invert_pose(BODY_T_CAM).tolist()}\n"
    calibration.write_text(text)
    return np.stack([body(0.05 * i) @ BODY_T_CAM for i in range(n)]), camera


def test_tum_vi(tmp_path: Path) -> None:
    true, camera = tum_vi(tmp_path / "room1")
    sequence = open_sequence("tum-vi", "room1", tmp_path)
    assert sequence.camera == camera
    assert sequence.image(2)[5, 5].tolist() == [9, 9, 9]  # 2257 / 257, rounded
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, true, atol=2e-5)
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.accel[0], [4, 5, 6])
    assert sequence.imu.T_body_cam is not None
    np.testing.assert_allclose(sequence.imu.T_body_cam, BODY_T_CAM, atol=1e-9)


def test_a_sequence_of_euroc(tmp_path: Path) -> None:
    """The same layout, with the sensor's own calibration and another name for the truth."""
    true, _ = tum_vi(tmp_path / "V1_01")
    mav0 = tmp_path / "V1_01" / "mav0"
    (mav0 / "mocap0").rename(mav0 / "state_groundtruth_estimate0")
    (tmp_path / "V1_01" / "dso" / "camchain.yaml").unlink()
    numbers = ", ".join(str(float(v)) for v in BODY_T_CAM.ravel())
    (mav0 / "cam0" / "sensor.yaml").write_text(
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\nrate_hz: 20\n"
        "resolution: [64, 64]\ncamera_model: pinhole\nintrinsics: [24, 24, 32, 32] #fu, fv, cu, cv\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [-0.2, 0.07, 0.0001, 0.00001]\n"
    )
    sequence = open_sequence("tum-vi", None, tmp_path / "V1_01")
    assert sequence.camera.kind == "pinhole"
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, true, atol=2e-5)


def test_bad_tum_vi(tmp_path: Path) -> None:
    folder = tmp_path / "room1"
    tum_vi(folder)
    csv = folder / "mav0/cam0/data.csv"
    whole = csv.read_text()
    rows = whole.splitlines()
    for k, row, message in [
        (2, "soon,a.png", r"data\.csv:3: 'soon' is not a number"),
        (2, "5,a.png", r"data\.csv:3: image 'a\.png' is missing"),
        (2, rows[1], r"data\.csv:3: time .* is not later"),
    ]:
        csv.write_text("\n".join([*rows[:k], row, *rows[k + 1 :]]))
        with pytest.raises(DatasetError, match=message):
            open_sequence("tum-vi", None, folder)
    csv.write_text(whole)
    chain = folder / "dso/camchain.yaml"
    chain.write_text("\n".join(line for line in chain.read_text().splitlines() if "T_cam_imu" not in line))
    with pytest.raises(CalibrationError, match=r"camchain\.yaml: .*T_cam_imu"):
        open_sequence("tum-vi", None, folder)
    chain.unlink()
    with pytest.raises(DatasetError, match="no calibration"):
        open_sequence("tum-vi", None, folder)


@pytest.mark.parametrize("name", ["360loc", "omniblender", "tum-vi", "360vo", "insta360-dual-fisheye"])
def test_an_empty_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(DatasetError, match="here"):
        open_dataset(name, tmp_path).sequences()


def test_rows_of_the_synpano_layout_are_shared(tmp_path: Path) -> None:
    save(tmp_path / "s/images/0.png", panorama(0))
    (tmp_path / "s/groundtruth.txt").write_text(f"0 0.png {pose_row(poses(1)[0])} 9\n")
    with pytest.raises(DatasetError, match=r"groundtruth\.txt:1: the row has 10 values"):
        open_sequence("360vo", None, tmp_path)

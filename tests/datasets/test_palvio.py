from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_samples import panorama, pose_row, save
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from panobench.cameras.factory import parse_camera_option
from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.datasets.formats.synpano import SynPano
from panobench.datasets.open import open_sequence
from panobench.datasets.palvio.calibration import STANDARD_GRAVITY, find_calibration, published_calibration
from panobench.datasets.palvio.dataset import Palvio
from panobench.datasets.palvio.mounting import LOOKING_UP
from panobench.datasets.palvio.synth import BagOptions, write_palvio_bag
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.errors import CalibrationError, DatasetError, UsageError
from panobench.geometry import invert_pose, make_pose, so3_exp, so3_log

STORE = get_typestore(Stores.ROS1_NOETIC)
IMAGE_TOPIC = "/mindvision/mindvision/left/image_mono"
SIZE = (256, 128)
FRAMES = 8


def walk(n: int) -> np.ndarray:
    """Poses in a world whose z axis is up: an upright camera that walks and turns."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: right, down, forward
    k = np.arange(n)[:, None]
    return make_pose(
        so3_exp(k * [[0.01, 0.0, 0.06]]) @ upright, np.concatenate([0.05 * k, 0.02 * k * k / n, 0.01 * k], 1)
    )


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> FrameSequence:
    folder = tmp_path_factory.mktemp("scene") / "room"
    lines = []
    for i, T in enumerate(walk(FRAMES)):
        save(folder / f"images/{i:06d}.png", panorama(i, SIZE))
        raw = T.copy()
        raw[:3, :3] = T[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        lines.append(f"{i} {i:06d}.png {pose_row(raw)}")
    (folder / "groundtruth.txt").write_text("\n".join(lines))
    return SynPano(folder).open()


@pytest.fixture(scope="module")
def bag(source: FrameSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_palvio_bag(tmp_path_factory.mktemp("palvio") / "ID01.bag", source, BagOptions(width=160, seed=3))


def copy_calibration(bag: Path, folder: Path) -> None:
    for path in bag.parent.glob("palvio*"):
        shutil.copy(path, folder)


def test_the_bag_has_the_published_topics_and_types(bag: Path) -> None:
    with Reader(bag) as reader:
        found = {name: info.msgtype for name, info in reader.topics.items()}
    assert found == {
        IMAGE_TOPIC: "sensor_msgs/msg/Image",
        "/mavros/imu/data": "sensor_msgs/msg/Imu",
        "/vicon/pal/pal": "nav_msgs/msg/Odometry",
    }


def test_reads_back_images_and_the_camera_s_poses(bag: Path, source: FrameSequence) -> None:
    sequence = Palvio(bag.parent).open("ID01")
    assert len(sequence) == FRAMES
    assert (sequence.camera.width, sequence.camera.height) == (160, 120)
    np.testing.assert_allclose(sequence.times - sequence.times[0], source.times, atol=1e-6)
    assert source.groundtruth is not None
    assert sequence.groundtruth is not None
    assert len(sequence.groundtruth) == FRAMES
    # The panorama's axes from the annular camera's: the published ground truth is neither, but the body's.
    choice = parse_camera_option("erp", sequence.camera, SIZE[0])
    back = Reprojector(sequence.camera, choice.camera, choice.R_target_source)
    recovered = back.poses(sequence.groundtruth.T_wc)
    assert np.abs(recovered[:, :3, 3] - source.groundtruth.positions).max() < 5e-4
    angle = np.linalg.norm(
        so3_log(np.swapaxes(recovered[:, :3, :3], 1, 2) @ source.groundtruth.T_wc[:, :3, :3]), axis=1
    )
    assert np.degrees(angle).max() < 0.02
    grey = source.image(5).astype(float) @ [0.299, 0.587, 0.114]
    error = np.abs(back.image(sequence.image(5))[..., 0] - grey)[back.valid]
    assert back.valid.mean() > 0.3
    assert error.mean() < 1.0


def test_images_in_any_order_and_resized(bag: Path) -> None:
    sequence = Palvio(bag).open()
    images = [frame.image for frame in sequence.frames()]
    for index in (7, 0, 4, 3, -1):
        np.testing.assert_array_equal(sequence.image(index), images[index])
    half = Palvio(bag).open(width=80)
    assert half.image(0).shape == (60, 80, 3)
    assert half.camera.valid_mask().shape == (60, 80)


def test_imu_is_on_the_camera_s_clock_and_agrees_with_the_motion(bag: Path) -> None:
    sequence = Palvio(bag).open()
    imu, truth = sequence.imu, sequence.groundtruth
    assert imu is not None
    assert truth is not None
    assert imu.times[0] == pytest.approx(sequence.times[0], abs=1e-6)
    assert imu.T_body_cam is not None
    body = truth.T_wc @ invert_pose(imu.T_body_cam)
    dt = truth.times[4] - truth.times[3]
    rate = so3_log(body[3, :3, :3].T @ body[4, :3, :3]) / dt
    between = (imu.times > truth.times[3]) & (imu.times < truth.times[4])
    np.testing.assert_allclose(imu.gyro[between].mean(axis=0), rate, atol=0.01)
    middle = np.searchsorted(imu.times, (truth.times[0] + truth.times[-1]) / 2)
    acceleration = np.gradient(np.gradient(body[:, :3, 3], truth.times, axis=0), truth.times, axis=0)[3:5].mean(axis=0)
    force = body[3, :3, :3].T @ (acceleration + [0, 0, STANDARD_GRAVITY])
    np.testing.assert_allclose(imu.accel[middle - 5 : middle + 5].mean(axis=0), force, atol=0.3)


def test_a_converted_sequence_says_where_its_own_camera_sits(bag: Path) -> None:
    source = Palvio(bag).open()
    choice = parse_camera_option("erp", source.camera, 64)
    converted = ConvertedSequence(source, choice.camera, choice.R_target_source)
    np.testing.assert_allclose(body_poses(converted), body_poses(source), atol=1e-9)  # both cameras give the same


def body_poses(sequence: FrameSequence) -> np.ndarray:
    assert sequence.groundtruth is not None
    assert sequence.imu is not None
    assert sequence.imu.T_body_cam is not None
    return sequence.groundtruth.T_wc @ invert_pose(sequence.imu.T_body_cam)


def test_built_in_calibration_has_the_published_numbers() -> None:
    calibration = published_calibration()
    camera = calibration.camera
    assert calibration.time_offset_s == -0.008
    np.testing.assert_allclose(calibration.body_T_cam[:3, 3], [0.0920902, 3.6525e-5, -0.0503303])
    np.testing.assert_allclose(calibration.body_T_cam[2, :3], [-0.021162, -0.9984603, -0.0512766], atol=1e-5)
    # theta = 90 degrees lies at r = 376.9 px.
    pixel, valid = camera.project(np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    assert valid.all()
    assert np.linalg.norm(pixel[0] - pixel[1]) / 2 == pytest.approx(376.9, abs=0.1)
    # The annulus lies between polar angles of about 38 and 117 degrees; its centre is 6 px off the camera's.
    polar = np.degrees(np.arccos(camera.rays()[camera.valid_mask()][:, 2]))
    assert polar.min() == pytest.approx(38, abs=2)
    assert polar.max() == pytest.approx(117, abs=2)


@pytest.mark.parametrize(
    ("mounting", "remark"),
    [
        (None, None),
        (LOOKING_UP, "that of LF-VIO's configuration file: by the IMU the one of its README is 9"),
        (np.diag([1.0, -1.0, -1.0, 1.0]), "by the IMU the camera's upward direction is 8"),
    ],
    ids=["README", "mindvision.yaml", "neither"],
)
def test_gravity_decides_between_the_published_poses_on_the_body(
    source: FrameSequence, tmp_path: Path, mounting: np.ndarray | None, remark: str | None
) -> None:
    """A bag that was made with one of them is read with the same, so that its ground truth is the source's."""
    path = write_palvio_bag(tmp_path / "b.bag", source, BagOptions(width=160, seed=3, body_T_cam=mounting))
    sequence = Palvio(path).open()
    assert [remark is not None and remark in r for r in sequence.remarks()] == ([] if remark is None else [True])
    assert source.groundtruth is not None
    assert sequence.groundtruth is not None
    off = np.abs(sequence.groundtruth.positions - source.groundtruth.positions[: len(sequence)]).max()
    assert (off < 5e-4) == (mounting is None or mounting is LOOKING_UP)


def test_a_pose_on_the_body_that_gravity_contradicts_is_said(bag: Path, tmp_path: Path) -> None:
    copy_calibration(bag, tmp_path)
    shutil.copy(bag, tmp_path)
    with (tmp_path / "palvio.yaml").open("a") as file:
        file.write(f"body_T_cam: {LOOKING_UP.tolist()}\n")
    sequence = Palvio(tmp_path / bag.name).open()
    assert sequence.imu is not None
    assert np.allclose(sequence.imu.T_body_cam, LOOKING_UP)  # it is the user's, and stays
    assert [r for r in sequence.remarks() if "degrees off the vertical" in r and "doubtful" in r]


def test_a_calibration_file_beside_the_data_replaces_values(tmp_path: Path) -> None:
    (tmp_path / "palvio.yaml").write_text("time_offset_s: 0.25\nimage_topic: /cam\n")
    calibration = find_calibration(tmp_path)
    assert calibration.time_offset_s == 0.25
    assert calibration.image_topic == "/cam"
    assert calibration.camera == published_calibration().camera
    for text, message in [
        ("time_ofset: 1", "unknown key 'time_ofset'"),
        ("imu_topic: /vicon/pal/pal", "three different topics"),
        ("[", "not valid YAML"),
        ("body_T_cam: [1, 2]", "not a rigid 4x4"),
        ("time_offset_s: soon", "must be a number"),
        ("camera: none.yaml", "none.yaml"),
        ("camera: odd.yaml", "did you mean 'pal'"),
    ]:
        (tmp_path / "odd.yaml").write_text("model: pall\nwidth: 3\n")
        (tmp_path / "palvio.yaml").write_text(text)
        with pytest.raises(CalibrationError, match=r"\.yaml") as caught:
            find_calibration(tmp_path)
        assert message in str(caught.value)


def test_extracted_folder(bag: Path, tmp_path: Path) -> None:
    recorded = Palvio(bag).open()
    assert recorded.groundtruth is not None
    folder = tmp_path / "ID07"
    lines = []
    for i, t in enumerate(recorded.times):
        save(folder / f"images/{round(t * 1e9)}.png", recorded.image(i)[..., 0])
        lines.append(f"{t:.9f} {pose_row(body_poses(recorded)[i])}")
    (folder / "groundtruth.tum").write_text("\n".join(lines))
    copy_calibration(bag, folder)
    sequence = open_sequence("palvio", "ID07", tmp_path)
    np.testing.assert_array_equal(sequence.image(3), recorded.image(3))
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, recorded.groundtruth.T_wc, atol=1e-6)
    save(folder / "images/noon.png", recorded.image(0)[..., 0])
    with pytest.raises(DatasetError, match=r"noon\.png: the file's name is not its time"):
        Palvio(folder).open()


def rewrite(source: Path, target: Path, change: Any) -> Path:
    """Copy a bag message by message; ``change(topic, message)`` returns (topic, message) or None to leave it out."""
    with Reader(source) as reader, Writer(target) as writer:
        known: dict[str, Any] = {}
        for connection, stamp, data in reader.messages():
            changed = change(connection.topic, STORE.deserialize_ros1(data, connection.msgtype))
            if changed is None:
                continue
            topic, message = changed
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], stamp, STORE.serialize_ros1(message, kind))
    return target


def fails(path: Path, bag: Path, message: str) -> None:
    copy_calibration(bag, path.parent)
    with pytest.raises(DatasetError, match=message) as caught:
        Palvio(path).open()
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bag_without_the_topic_lists_those_it_has(bag: Path, tmp_path: Path) -> None:
    path = rewrite(bag, tmp_path / "x.bag", lambda t, m: None if t == IMAGE_TOPIC else (t, m))
    fails(
        path, bag, rf"no topic '{IMAGE_TOPIC}'; it has: /mavros/imu/data \(sensor_msgs/msg/Imu, \d+\), /vicon/pal/pal"
    )


def test_a_bag_without_an_imu_says_so(bag: Path, tmp_path: Path) -> None:
    path = rewrite(bag, tmp_path / "x.bag", lambda t, m: None if "imu" in t else (t, m))
    copy_calibration(bag, tmp_path)
    sequence = Palvio(path).open()
    assert sequence.imu is None
    assert "there are no inertial samples on /mavros/imu/data" in sequence.remarks()


def test_a_topic_of_another_type(bag: Path, tmp_path: Path) -> None:
    path = rewrite(bag, tmp_path / "x.bag", lambda t, m: (IMAGE_TOPIC, m) if "imu" in t else None)
    fails(path, bag, r"messages of type sensor_msgs/msg/Imu, expected sensor_msgs/msg/Image")


def test_an_unexpected_encoding(bag: Path, tmp_path: Path) -> None:
    def change(topic: str, message: Any) -> Any:
        if topic == IMAGE_TOPIC and message.header.seq == 2:
            message.encoding = "32FC1"
        return topic, message

    fails(rewrite(bag, tmp_path / "x.bag", change), bag, r"frame 2: the image has encoding '32FC1'; mono")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("height", 119, "frame 2: the image is 160x119 pixels, the first one is 160x120"),
        ("height", 500, "frame 2: a 160x500 mono8 image cannot have 19200 bytes"),
        ("step", 10, "frame 2: a 160x120 mono8 image cannot have"),
        ("width", 100_000, "frame 2: the image claims 100000x120 pixels"),
    ],
)
def test_inconsistent_images(bag: Path, tmp_path: Path, field: str, value: int, message: str) -> None:
    def change(topic: str, m: Any) -> Any:
        if topic == IMAGE_TOPIC and m.header.seq == 2:
            setattr(m, field, value)
        return topic, m

    fails(rewrite(bag, tmp_path / "x.bag", change), bag, message)


def test_poses_that_are_none(bag: Path, tmp_path: Path) -> None:
    def change(topic: str, m: Any) -> Any:
        if "vicon" in topic and m.header.seq == 5:
            m.pose.pose.position.x = float("nan")
        return topic, m

    fails(rewrite(bag, tmp_path / "x.bag", change), bag, r"frame 5: a message of '/vicon/pal/pal' holds NaN")


def test_truncated_and_foreign_bags(bag: Path, tmp_path: Path) -> None:
    data = bag.read_bytes()
    path = tmp_path / "x.bag"
    for length in (len(data) - 100, len(data) // 2, 5000, 100):
        path.write_bytes(data[:length])
        fails(path, bag, "truncated or damaged: .* run `rosbag reindex`" if length > 100 else "truncated or damaged")
    path.write_bytes(b"SQLite format 3\0" + data[:1000])
    fails(path, bag, "truncated or damaged")
    path.write_bytes(b"")
    fails(path, bag, "not a bag of ROS 1")


def test_damage_anywhere_is_an_error_a_user_can_read(bag: Path, tmp_path: Path) -> None:
    data = bag.read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "x.bag"
    copy_calibration(bag, tmp_path)
    outcomes = set()
    for _ in range(15):
        damaged = bytearray(data)
        at = int(rng.integers(0, len(data)))
        damaged[at : at + 8] = rng.bytes(8)
        path.write_bytes(bytes(damaged))
        try:
            sequence = Palvio(path).open()
            for i in range(len(sequence)):
                sequence.image(i)
            outcomes.add("read")
        except DatasetError:
            outcomes.add("refused")
    assert "refused" in outcomes


def test_an_unindexed_bag_says_so(bag: Path, tmp_path: Path) -> None:
    data = bytearray(bag.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    (tmp_path / "x.bag").write_bytes(bytes(data))
    fails(tmp_path / "x.bag", bag, "rosbag reindex")


def test_the_generator_refuses_what_it_cannot_do(source: FrameSequence, bag: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="exists already"):
        write_palvio_bag(bag, source)
    with pytest.raises(UsageError, match=r"must end in \.bag"):
        write_palvio_bag(tmp_path / "x.mp4", source)
    with pytest.raises(UsageError, match="at least 4 frames"):
        write_palvio_bag(tmp_path / "x.bag", source, BagOptions(frames=2))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.data
def test_bag_at_hand() -> None:
    path = Path(os.environ.get("PANOBENCH_TEST_DATA", "/nonexistent"), "palvio/ID01.bag")
    if not path.is_file():
        pytest.skip("PANOBENCH_TEST_DATA has no palvio/ID01.bag")
    sequence = open_sequence("palvio", "ID01", path.parent)
    assert len(sequence) == 36
    room = open_sequence("synpano", "devroom", path.parents[1] / "synpano")
    assert sequence.groundtruth is not None
    assert room.groundtruth is not None
    offset = sequence.groundtruth.positions - room.groundtruth.positions[: len(sequence.groundtruth)]
    assert np.linalg.norm(offset, axis=1).max() < 5e-4

"""Bags of every kind: what is read of them, what is chosen, and what is said."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import bag_samples as samples
import cv2
import numpy as np
import pytest
from bag_samples import FRAMES, KINDS, SIZE, START, Recording, write
from dataset_samples import panorama, poses

from panobench.cli.main import run as panobench
from panobench.datasets.bags import files, layout
from panobench.datasets.bags.dataset import Bag
from panobench.datasets.bags.files import BagFile
from panobench.datasets.base import FrameSequence
from panobench.datasets.given import Given
from panobench.errors import CalibrationError, DatasetError
from panobench.geometry import invert_pose, make_pose, so3_exp


def opened(path: Path, **given: Any) -> FrameSequence:
    dataset = Bag(path)
    dataset.given = Given(**given)
    return dataset.open()


def usual(recording: Recording) -> None:
    samples.images(recording)
    samples.truth(recording)
    for k in range(40):
        recording.add("/imu", recording.messages.imu(START + 0.0125 * k, (k, 0, 0), (0, 0, 9.8)))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_is_the_same_sequence(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "walk", usual, kind)
    sequence = opened(path)
    assert sequence.name == "walk"
    assert len(sequence) == FRAMES
    np.testing.assert_allclose(sequence.times, samples.times(), atol=1e-6)
    for index in (3, 0, 5, 1, 2, 4, -1):
        np.testing.assert_array_equal(sequence.image(index), panorama(range(FRAMES)[index]))
    assert sequence.camera.kind == "erp"
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-9)
    assert sequence.imu is not None
    assert len(sequence.imu.times) == 40
    np.testing.assert_allclose(sequence.imu.gyro[7], [7, 0, 0])
    about = sequence.provenance()
    assert about["image_topic"] == "/cam/image_raw"
    assert about["groundtruth_topic"] == "/gt"
    assert Bag(path).open(width=32).image(0).shape == (16, 32, 3)


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_storage_file_by_itself(tmp_path: Path, kind: str) -> None:
    folder = write(tmp_path / "walk", usual, kind)
    (storage,) = [p for p in folder.iterdir() if p.name != "metadata.yaml"]
    assert len(opened(storage)) == FRAMES
    for broken in (b"", b"rosbag2_bagfile_information: {version: 9"):
        (folder / "metadata.yaml").write_bytes(broken)
        assert len(opened(folder)) == FRAMES
    (folder / "metadata.yaml").unlink()
    assert len(opened(tmp_path)) == FRAMES


@pytest.mark.parametrize("name", ["a b", "50%25 #1?", "10:30", "mühle"])
@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap"])
def test_names_that_mean_something_elsewhere(tmp_path: Path, name: str, kind: str) -> None:
    path = write(tmp_path / "walk", usual, kind)
    if path.is_dir():
        (path / f"walk.{kind}").rename(path / f"{name}.{kind}")
    path = path.rename(tmp_path / (name + path.suffix))
    assert len(opened(path)) == FRAMES
    assert opened(path).name == name


@pytest.mark.parametrize("kind", ["ros1", "db3"])
def test_names_that_are_not_utf_8(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "walk", usual, kind)
    if path.is_dir():
        path = path / "walk.db3"
    renamed = Path(os.fsdecode(os.fsencode(path.parent) + b"/caf\xe9" + path.suffix.encode()))
    path.rename(renamed)
    assert len(opened(renamed)) == FRAMES


def test_a_bag_in_parts(tmp_path: Path) -> None:
    """Recorders begin a new file when one is large; the tenth comes after the second."""
    folder = tmp_path / "walk"
    folder.mkdir()
    for k in range(12):

        def one(recording: Recording, k: int = k) -> None:
            recording.add("/cam", recording.messages.image(START + 0.1 * k, panorama(k)))

        part = write(tmp_path / f"part{k}", one, "db3")
        shutil.move(str(part / f"part{k}.db3"), folder / f"walk_{k}.db3")
        shutil.rmtree(part)
    sequence = opened(folder)
    assert len(sequence) == 12
    for k in (11, 0, 5):
        np.testing.assert_array_equal(sequence.image(k), panorama(k))
    assert Bag(tmp_path).sequences() == ["walk"]
    names = "".join(f"    - walk_{k}.db3\n" for k in range(13))
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{names}")
    with pytest.raises(DatasetError, match=r"incomplete: 'walk_12\.db3' is missing, which metadata\.yaml names"):
        opened(folder)


def test_folders_of_bags(tmp_path: Path) -> None:
    write(tmp_path / "floor_1/run_2", usual, "db3")
    write(tmp_path / "floor_1/run_10", usual, "mcap")
    write(tmp_path / "walk", usual)
    (tmp_path / "._walk.bag").write_bytes(b"x")
    shutil.copy(tmp_path / "floor_1/run_10/run_10.mcap", tmp_path / "walk.mcap")
    assert Bag(tmp_path).sequences() == ["walk.bag", "walk.mcap", "floor_1/run_2", "floor_1/run_10"]
    assert len(Bag(tmp_path).open("floor_1/run_10")) == FRAMES
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="no bag here"):
        Bag(tmp_path / "empty").open()


@pytest.mark.parametrize("ros1", [True, False], ids=["ROS 1", "ROS 2"])
@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16", "rgb8", "bgr8", "8UC3", "rgba8", "bgra8", "rgb16",
                                      "bgr16", "bgra16", "yuv422", "yuv422_yuy2", "nv12", "nv21"])  # fmt: skip
def test_encodings(tmp_path: Path, encoding: str, ros1: bool) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(3)):
            recording.add("/cam", encoded(recording, t, panorama(i), encoding))

    sequence = opened(write(tmp_path / "walk", fill, "ros1" if ros1 else "mcap"))
    shown = sequence.image(1).astype(int)
    expected = panorama(1)
    if encoding in ("mono8", "8UC1", "mono16"):
        expected = np.repeat(cv2.cvtColor(expected, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)
    tolerance = 12 if encoding.startswith(("yuv", "nv")) else 1
    assert np.abs(shown - expected).max() <= tolerance


def encoded(recording: Recording, time: float, rgb: np.ndarray, encoding: str) -> Any:
    make = recording.messages.image
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if encoding in ("mono8", "8UC1"):
        return make(time, grey, encoding)
    if encoding == "mono16":  # as cameras on the network send it
        return make(time, (grey.astype(">u2") * 257), encoding, is_bigendian=1)
    if encoding in ("yuv422", "yuv422_yuy2"):
        yuv = studio_yuv(rgb)
        packed = np.zeros((*grey.shape, 2), np.uint8)
        luma, chroma = (1, 0) if encoding == "yuv422" else (0, 1)
        packed[..., luma] = yuv[..., 0]
        packed[:, 0::2, chroma], packed[:, 1::2, chroma] = yuv[:, 0::2, 1], yuv[:, 0::2, 2]
        return make(time, packed, encoding)
    if encoding in ("nv12", "nv21"):
        yuv = studio_yuv(rgb)
        first, second = (1, 2) if encoding == "nv12" else (2, 1)
        chroma = np.stack([yuv[0::2, 0::2, first], yuv[0::2, 0::2, second]], axis=-1).reshape(-1, grey.shape[1])
        return make(time, np.concatenate([yuv[..., 0], chroma]), encoding, height=grey.shape[0])
    deep = encoding.endswith("16")
    stored = rgb if encoding.startswith("rgb") else rgb[..., ::-1]
    if "a" in encoding:
        stored = np.concatenate([stored, np.full((*grey.shape, 1), 9, np.uint8)], axis=2)
    return make(time, stored.astype(np.uint16) * 257 if deep else stored, encoding)


def studio_yuv(rgb: np.ndarray) -> np.ndarray:
    """BT.601 with the limited range of video."""
    r, g, b = np.moveaxis(rgb.astype(float) / 255, 2, 0)
    y = 16 + 65.481 * r + 128.553 * g + 24.966 * b
    u = 128 - 37.797 * r - 74.203 * g + 112 * b
    v = 128 + 112 * r - 93.786 * g - 18.214 * b
    return np.stack([y, u, v], axis=2).round().astype(np.uint8)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("how", ["8", "16", "jpeg", "png"])
def test_bayer_patterns(tmp_path: Path, pattern: str, how: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(2)):
            rgb = panorama(i)
            mosaic = np.empty(rgb.shape[:2], np.uint8)
            for at, colour in enumerate(pattern):
                row, column = divmod(at, 2)
                mosaic[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
            if how in ("8", "16"):
                stored = mosaic if how == "8" else mosaic.astype(np.uint16) * 257
                recording.add("/cam", recording.messages.image(t, stored, f"bayer_{pattern}{how}"))
            else:
                suffix = ".png" if how == "png" else ".jpg"
                form = f"bayer_{pattern}8; {how} compressed bayer_{pattern}8"
                recording.add("/cam/compressed", recording.messages.compressed(t, mosaic, form, suffix))

    shown = opened(write(tmp_path / "walk", fill)).image(1).astype(int)
    inside = np.s_[2:-2, 2:-2]
    difference = np.abs(shown - panorama(1))[inside]
    assert difference.mean() < (12 if how == "jpeg" else 6)


def test_cameras_that_use_a_part_of_sixteen_bits(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(3)):
            grey = cv2.cvtColor(panorama(i), cv2.COLOR_RGB2GRAY)
            recording.add("/cam", recording.messages.image(t, grey.astype(np.uint16) * 16, "mono16"))

    sequence = opened(write(tmp_path / "walk", fill))
    grey = cv2.cvtColor(panorama(2), cv2.COLOR_RGB2GRAY).astype(int)
    assert np.abs(sequence.image(2)[..., 0] - grey).max() <= 1
    assert any("use 12 of 16 bits" in line for line in sequence.remarks())


@pytest.mark.parametrize(("form", "suffix"), [("jpeg", ".jpg"), ("rgb8; png compressed bgr8", ".png"), ("", ".webp")])
def test_compressed_images(tmp_path: Path, form: str, suffix: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times()):
            recording.add("/cam/compressed", recording.messages.compressed(t, panorama(i), form, suffix))

    sequence = opened(write(tmp_path / "walk", fill, "mcap"), topic="cam")
    assert np.abs(sequence.image(4).astype(int) - panorama(4)).mean() < 4


def test_padded_rows(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        wide = np.pad(panorama(0), ((0, 0), (0, 5), (0, 0)))
        for t in samples.times(2):
            recording.add("/cam", recording.messages.image(t, wide, width=SIZE[0]))

    np.testing.assert_array_equal(opened(write(tmp_path / "walk", fill)).image(0), panorama(0))


@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap"])
def test_stamps_in_any_order(tmp_path: Path, kind: str) -> None:
    """Drivers with threads swap images, repeat some, send empty ones, and some before their clock is set."""

    def fill(recording: Recording) -> None:
        t = samples.times(6)
        add, make = recording.add, recording.messages.image
        add("/cam", make(0.0, panorama(9)), received=START - 1)
        for rank, i in enumerate((0, 2, 1, 3, 3, 5, 4)):
            add("/cam", make(t[i], panorama(i)), received=START + 0.1 * rank)
        add("/cam", make(t[5] + 1, np.zeros((32, 64, 3)), data=np.zeros(0, np.uint8)), received=START + 2)

    sequence = opened(write(tmp_path / "walk", fill, kind))
    np.testing.assert_allclose(sequence.times, samples.times(6), atol=1e-6)
    for i in range(6):
        np.testing.assert_array_equal(sequence.image(i), panorama(i))
    assert sequence.remarks() == [
        "2 images are out of time order: all are sorted by their stamps",
        "1 image is left out: another one has the same stamp",
        "2 images are left out: no pixels or no stamp",
    ]


def test_messages_received_at_the_same_moment(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(6)):
            recording.add("/cam", recording.messages.image(t, panorama(i)), received=START + (i // 3))

    for kind in ("ros1", "db3", "mcap"):
        sequence = opened(write(tmp_path / kind, fill, kind))
        for i in (5, 1, 2, 0, 4):
            np.testing.assert_array_equal(sequence.image(i), panorama(i))


def test_without_any_stamps(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for i, (t, T) in enumerate(zip(samples.times(), poses(FRAMES))):
            recording.add("/cam", recording.messages.image(0.0, panorama(i)), received=t)
            recording.add("/gt", recording.messages.pose("PoseStamped", 0.0, T), received=t)

    sequence = opened(write(tmp_path / "walk", fill))
    np.testing.assert_allclose(sequence.times, samples.times(), atol=1e-6)
    assert sequence.groundtruth is not None
    assert len(sequence.groundtruth) == FRAMES
    assert "the images have no stamps; the times at which the recorder received them are used" in sequence.remarks()


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "PoseWithCovarianceStamped", "Odometry"])
def test_kinds_of_true_poses(tmp_path: Path, kind: str) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        samples.truth(recording, "/vicon/head", kind)

    sequence = opened(write(tmp_path / "walk", fill, "db3"))
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-9)
    assert any(
        line.startswith("true poses are from /vicon/head, taken for the camera's") for line in sequence.remarks()
    )


def test_odometry_is_not_the_truth_unless_somebody_says_so(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        samples.truth(recording, "/odom", "Odometry")

    path = write(tmp_path / "walk", fill)
    sequence = opened(path)
    assert sequence.groundtruth is None
    assert "poses on /odom are not taken for the truth; --groundtruth-topic chooses some" in sequence.remarks()
    chosen = opened(path, groundtruth_topic="odom")
    assert chosen.groundtruth is not None
    assert opened(write(tmp_path / "other", usual), groundtruth_topic="none").groundtruth is None


LEVER = make_pose(so3_exp(np.array([0.3, -0.2, 1.0])), np.array([0.1, 0.2, -0.3]))


def test_poses_of_a_body_are_moved_to_the_camera(tmp_path: Path) -> None:
    """By /tf_static: body -> mast -> cam; also for the inertial samples."""
    mast = make_pose(so3_exp(np.array([0.0, 0.4, 0.0])), np.array([0.0, 0.0, 1.0]))

    def fill(recording: Recording) -> None:
        samples.images(recording)
        make = recording.messages
        recording.add("/tf_static", make.static("mast", "cam", invert_pose(mast) @ LEVER))
        recording.add("/tf_static", make.static("body", "mast", mast))
        recording.add("/tf_static", make.static("imu", "body", invert_pose(mast)))
        for t, T in zip(samples.times(), poses(FRAMES)):
            recording.add("/gt", make.pose("Odometry", t, T @ invert_pose(LEVER)))
            recording.add("/imu", make.imu(t, (0, 0, 0), (0, 0, 9.8)))

    for kind in ("ros1", "mcap"):
        sequence = opened(write(tmp_path / kind, fill, kind))
        assert sequence.groundtruth is not None
        np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-9)
        assert sequence.imu is not None
        np.testing.assert_allclose(sequence.imu.T_body_cam, invert_pose(mast) @ LEVER, atol=1e-9)
        assert any("those of 'body', moved to the camera by /tf_static" in line for line in sequence.remarks())


def test_extrinsics_and_clock_of_a_calibration(tmp_path: Path) -> None:
    T = "\n".join(f"  - {row.tolist()}" for row in invert_pose(LEVER))
    (tmp_path / "chain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n  intrinsics: [30, 30, 32, 16]\n"
        f"  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [64, 32]\n  T_cam_imu:\n{T}\n  timeshift_cam_imu: 0.25\n"
    )

    def fill(recording: Recording) -> None:
        samples.images(recording)
        for t, T in zip(samples.times(), poses(FRAMES)):
            recording.add("/gt", recording.messages.pose("PoseStamped", t, T @ invert_pose(LEVER)))
            recording.add("/imu", recording.messages.imu(t + 0.25, (0, 0, 0), (0, 0, 9.8)))

    sequence = opened(write(tmp_path / "walk", fill), calibration=f"{tmp_path / 'chain.yaml'}#cam0")
    assert sequence.camera.kind == "fisheye"
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(FRAMES), atol=1e-6)
    assert sequence.imu is not None
    np.testing.assert_allclose(sequence.imu.times, sequence.times, atol=1e-6)
    np.testing.assert_allclose(sequence.imu.T_body_cam, LEVER, atol=1e-6)


@pytest.mark.parametrize("kind", ["ros1", "db3"])
@pytest.mark.parametrize(
    ("topic", "model", "D", "camera"),
    [
        ("/cam/image_raw", "equidistant", [0.01, 0.0, 0.0, 0.0], "fisheye"),
        ("/cam/image_raw", "plumb_bob", [-0.1, 0.01, 0.0, 0.0, 0.0], "pinhole"),
        ("/cam/image_rect", "plumb_bob", [-0.1, 0.01, 0.0, 0.0, 0.0], "pinhole"),
    ],
)
def test_the_camera_from_camera_info(
    tmp_path: Path, kind: str, topic: str, model: str, D: list[float], camera: str
) -> None:
    K = [30.0, 0.0, 31.5, 0.0, 30.0, 15.5, 0.0, 0.0, 1.0]

    def fill(recording: Recording) -> None:
        samples.images(recording, topic)
        info = recording.messages.camera_info(SIZE, K, D, model)
        info.roi.width, info.roi.height = SIZE
        recording.add("/cam/camera_info", info, received=START)
        other = recording.messages.camera_info((99, 99), K, D, model)
        recording.add("/cam2/camera_info", other, received=START)

    sequence = opened(write(tmp_path / "walk", fill, kind))
    assert sequence.camera.kind == camera
    centre, _ = sequence.camera.project(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(centre, [32, 16])
    assert "the camera is from /cam/camera_info" in sequence.remarks()
    edge, _ = sequence.camera.project(np.array([0.5, 0.0, 1.0]))
    assert (edge[0] == pytest.approx(47)) == topic.endswith("rect")


def test_an_uncalibrated_camera_info_says_nothing(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording)
        recording.add("/cam/camera_info", recording.messages.camera_info(SIZE, [0.0] * 9, [], ""), received=START)

    assert opened(write(tmp_path / "walk", fill)).camera.kind == "erp"


def test_choosing_among_topics(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        samples.images(recording, "/back/image_raw", 4)
        samples.images(recording, "/front/image_raw", 6)
        for i, t in enumerate(samples.times(6)):
            recording.add("/front/image_raw/compressed", recording.messages.compressed(t, panorama(i)))
            deep = np.full((32, 64), 1000 + i, np.uint16)
            recording.add("/depth/image", recording.messages.image(t, deep, "16UC1"))
            recording.add("/depth/image", recording.messages.image(t + 0.01, deep, "16UC1"))
        for k in range(9):
            recording.add("/imu/slow", recording.messages.imu(START + 0.1 * k, (0, 0, 0), (0, 0, 9.8)))
            recording.add("/imu/fast", recording.messages.imu(START + 0.1 * k, (1, 0, 0), (0, 0, 9.8)))
            recording.add("/imu/fast", recording.messages.imu(START + 0.1 * k + 0.05, (1, 0, 0), (0, 0, 9.8)))

    path = write(tmp_path / "walk", fill)
    sequence = opened(path)
    assert len(sequence) == 6
    assert sequence.provenance()["image_topic"] == "/front/image_raw"
    assert sequence.remarks() == [
        "the images are those of /front/image_raw; --topic chooses others: /back/image_raw, /depth/image",
        "the inertial samples are those of /imu/fast; --imu-topic chooses others: /imu/slow",
    ]
    other = opened(path, topic="/back/image_raw", imu_topic="imu/slow")
    assert len(other) == 4
    assert other.imu is not None
    assert len(other.imu.times) == 9
    with pytest.raises(DatasetError, match=r"no topic '/side'; it has: /back/image_raw \(sensor_msgs/msg/Image, 4\)"):
        opened(path, topic="/side")
    with pytest.raises(DatasetError, match="messages of type sensor_msgs/msg/Imu, expected sensor_msgs/msg/Image or"):
        opened(path, topic="/imu/fast")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoding": "32FC1"}, r"frame 1: the image has encoding '32FC1'; mono, rgb"),
        ({"height": 500}, r"frame 1: a 64x500 rgb8 image cannot have 6144 bytes"),
        ({"step": 10}, r"frame 1: a 64x32 rgb8 image cannot have 6144 bytes"),
        ({"width": 100_000}, r"frame 1: the image claims 100000x32 pixels"),
        ({"width": 62}, r"frame 1: the image is 62x32 pixels, the first one is 64x32"),
    ],
)
def test_images_that_are_none(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(2)):
            recording.add("/cam", recording.messages.image(t, panorama(i), **(change if i else {})))

    with pytest.raises(DatasetError, match=message) as caught:
        opened(write(tmp_path / "walk", fill, "mcap"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "form", "message"),
    [
        (b"\0\0\0\1gE", "h264", r"not read \(format 'h264'\): not a PNG, JPEG"),
        (b"\x89PNG\r\n", "16UC1; compressedDepth png", "these are depth maps; choose the images with --topic"),
    ],
)
def test_compressed_data_that_are_no_picture(tmp_path: Path, data: bytes, form: str, message: str) -> None:
    def fill(recording: Recording) -> None:
        image = recording.messages.compressed(START, panorama(0), form)
        image.data = np.frombuffer(data, np.uint8)
        recording.add("/cam/compressed", image)

    with pytest.raises(DatasetError, match=message):
        opened(write(tmp_path / "walk", fill))


def test_a_lens_nobody_describes(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for t in samples.times(2):
            recording.add("/cam", recording.messages.image(t, np.zeros((48, 64), np.uint8), "mono8"))

    path = write(tmp_path / "walk", fill)
    with pytest.raises(DatasetError, match=r"64x48 pixels.*If a lens took it, say which: --calibration FILE"):
        opened(path)
    (tmp_path / "camera.yaml").write_text("model: pinhole\nwidth: 99\nheight: 48\nfx: 9\nfy: 9\ncx: 9\ncy: 9\n")
    with pytest.raises(CalibrationError, match="the calibration is for 99x48 images, these are 64x48"):
        opened(path)


def test_without_images(tmp_path: Path) -> None:
    path = write(tmp_path / "walk", lambda recording: samples.truth(recording))
    with pytest.raises(DatasetError, match=r"the bag has no images .* it has: /gt \(geometry_msgs/msg/Pose"):
        opened(path)


@pytest.mark.parametrize("kind", ["ros1", "db3", "mcap", "mcap-storage", "db3-file"])
def test_damage_is_an_error_a_user_can_read(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "walk", usual, kind)
    if path.is_dir():
        (path,) = [p for p in path.iterdir() if p.name != "metadata.yaml"]
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    cut = [data[: len(data) // k] for k in (2, 3, 50)] + [data[:-30]]
    for _ in range(25):
        broken = bytearray(data)
        at = int(rng.integers(0, len(data)))
        broken[at : at + 8] = rng.bytes(8)
        cut.append(bytes(broken))
    refused: list[str] = []
    for content in cut:
        path.write_bytes(content)
        try:
            sequence = opened(path)
            for i in range(len(sequence)):
                sequence.image(i)
        except DatasetError as error:
            refused.append(str(error))
    assert not any("\n" in line for line in refused)
    assert len(refused) >= (2 if kind.startswith("db3") else 3)


def test_a_recording_that_was_cut_off_says_what_repairs_it(tmp_path: Path) -> None:
    folder = write(tmp_path / "walk", usual, "mcap")
    path = folder / "walk.mcap"
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(DatasetError, match="run `mcap recover` on it"):
        opened(folder)


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V1.2\n", b"\x89PNG\r\n", b"not a bag at all"])
def test_files_that_are_no_bags(tmp_path: Path, content: bytes) -> None:
    for name in ("a.bag", "a.db3", "a.mcap"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DatasetError, match=r"not a bag of ROS 1|older than ROS 1's version 2\.0"):
            opened(tmp_path / name)


@pytest.mark.parametrize("kind", ["ros1-bz2", "ros1-lz4", "mcap-storage", "db3-message"])
def test_what_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    path = write(tmp_path / "walk", usual, kind)
    monkeypatch.setattr(files, "MAX_CHUNK_BYTES", 4000)
    with pytest.raises(DatasetError, match="unpacks to more than"):
        opened(path)


def test_a_file_that_unpacks_to_more_than_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "walk", usual, "db3-file")
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 1000})())
    with pytest.raises(DatasetError, match="no room to unpack it"):
        opened(path)


def test_reading_on_is_not_seeking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames in order are read by one pass; a chunk of MCAP is not unpacked for each of its images."""
    bag = BagFile(write(tmp_path / "walk", usual, "mcap-storage"))
    places = [record.place for record in bag.records({"/cam/image_raw"})]
    sought = []
    original = BagFile._from

    def counted(self: BagFile, *words: Any) -> Any:
        sought.append(words)
        return original(self, *words)

    monkeypatch.setattr(BagFile, "_from", counted)
    for place in places:
        assert bag.at("/cam/image_raw", place).place == place
    assert len(sought) == 1
    bag.at("/cam/image_raw", places[0])
    assert len(sought) == 2


def test_probing_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "walk", usual, "mcap")
    assert panobench(["probe", str(path)]) == 0
    said = capsys.readouterr().out
    assert "a bag of ROS 2 (--dataset bag)" in said
    assert "topics        /cam/image_raw (sensor_msgs/msg/Image, 6)\n              /gt (geometry_msgs" in said
    assert "IMU           40 samples" in said
    assert "true poses are from /gt" in said
    assert panobench(["probe", str(path), "--topic", "/nothing", "--json"]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["contents"][0] == "/cam/image_raw (sensor_msgs/msg/Image, 6)"
    assert "has no topic '/nothing'" in said.err


def test_probing_a_bag_of_an_unknown_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def fill(recording: Recording) -> None:
        for t in samples.times(2):
            recording.add("/cam", recording.messages.image(t, np.zeros((48, 64), np.uint8), "mono8"))

    path = write(tmp_path / "walk", fill)
    assert panobench(["probe", str(path)]) == 2
    said = capsys.readouterr()
    assert "/cam (sensor_msgs/msg/Image, 2)" in said.out
    assert f"try: panobench run --method sparse --root {path} --calibration FILE" in said.out
    assert len(said.err.strip().splitlines()) == 1


def test_other_commands_take_the_same_options(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for t in samples.times(2):
            recording.add("/left", recording.messages.image(t, np.full((48, 64), 90, np.uint8), "mono8"))
            recording.add("/right", recording.messages.image(t, np.full((48, 64), 200, np.uint8), "mono8"))

    path = write(tmp_path / "walk", fill, "db3")
    lens = tmp_path / "lens.yaml"
    lens.write_text("model: pinhole\nwidth: 64\nheight: 48\nfx: 40\nfy: 40\ncx: 32\ncy: 24\n")
    out = tmp_path / "out"
    words = ["--topic", "/right", "--calibration", str(lens), "--to", "erp", "--width", "64", "--out", str(out)]
    assert panobench(["convert", "bag", "--root", str(path), *words, "--quiet"]) == 0
    pictures = sorted(out.glob("**/images/*.png"))
    assert len(pictures) == 2
    assert cv2.imread(str(pictures[0])).max() == 200
    assert panobench(["view", str(path), "--topic", "/left", "--camera", str(lens), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "walk.sheet.png").is_file()


def test_names_of_bags() -> None:
    assert layout.bag_name(Path("a/walk.db3.zstd")) == "walk"
    assert layout.bag_name(Path("a/2024.05.01.bag")) == "2024.05.01"

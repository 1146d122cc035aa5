"""Bags of every kind: what is read of them, in which order, and which topics are chosen."""

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
from bag_samples import FRAMES, KINDS, START, Recording, opened, usual, write
from dataset_samples import panorama, poses

from panobench.cli.main import run as panobench
from panobench.datasets.bags import layout
from panobench.datasets.bags.dataset import Bag
from panobench.datasets.bags.files import BagFile
from panobench.errors import DatasetError


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
    assert [Bag(path).open(width=width).enlargement for width in (32, 3 * sequence.camera.width)] == [1.0, 3.0]


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

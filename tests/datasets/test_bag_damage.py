"""Bags that are damaged, cut off, empty or hostile."""

from __future__ import annotations

from pathlib import Path

import bag_samples as samples
import numpy as np
import pytest
from bag_samples import opened, usual, write

from panobench.datasets.bags import files
from panobench.errors import DatasetError


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

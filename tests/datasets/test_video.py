from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import video

from panobench.datasets.files.images import encode_image
from panobench.datasets.formats.video import Video, video_files
from panobench.datasets.inspection.guess import guess
from panobench.datasets.open import open_sequence
from panobench.errors import DatasetError, UnknownNameError


def level(image: np.ndarray) -> int:
    """The frame number written into the lower half (colour conversion takes one off)."""
    return round((float(image[20:].mean()) - 9) / 4)


def test_frames_in_order_and_at_random_are_the_same(tmp_path: Path) -> None:
    sequence = Video(video(tmp_path / "walk.mp4", 60)).open()
    assert len(sequence) == 60
    np.testing.assert_allclose(sequence.times, np.arange(60) / 24)
    images = [frame.image for frame in sequence.frames()]
    assert [level(image) for image in images] == list(range(60))
    for index in (59, 0, 58, 3, 3, 2, 55, 1, 30):
        np.testing.assert_array_equal(sequence.image(index), images[index])
    assert level(sequence.image(-1)) == 59
    assert sequence.groundtruth is None
    width = sequence.camera.width
    assert [Video(tmp_path / "walk.mp4").open(width=w).enlargement for w in (width // 2, 2 * width)] == [1.0, 2.0]


def test_folder_of_videos_names_and_masks(tmp_path: Path) -> None:
    video(tmp_path / "a.mp4", 3)
    video(tmp_path / "b.mp4", 5)
    mask = np.ones((32, 64), bool)
    mask[24:] = False
    (tmp_path / "b.mask.png").write_bytes(encode_image(mask, ".png"))
    assert Video(tmp_path).sequences() == ["a", "b"]
    sequence = open_sequence("video", "b", tmp_path, 32)
    assert len(sequence) == 5
    np.testing.assert_array_equal(sequence.camera.valid_mask(), mask[::2, ::2])
    assert open_sequence("video", "a", tmp_path).camera.mask is None
    with pytest.raises(UnknownNameError):
        open_sequence("video", "c", tmp_path)


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["GS010013.mp4", "GL010013.LRV", "GS010013.THM"], ["GS010013"]),
        (["VID_20230412_153012_00_001.mp4", "LRV_20230412_153012_01_001.mp4"], ["VID_20230412_153012_00_001"]),
        (["GL010013.LRV"], ["GL010013"]),  # better than nothing
    ],
)
def test_small_copies_that_cameras_keep_are_no_sequences(tmp_path: Path, names: list[str], found: list[str]) -> None:
    for name in names:
        (tmp_path / name).touch()
    assert list(video_files(tmp_path)) == found
    assert guess(tmp_path).what == "a video"


def test_bad_videos(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no video here"):
        Video(tmp_path).open()
    path = tmp_path / "v.mp4"
    whole = video(tmp_path / "w.mp4").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])  # the index at the end is gone
    with pytest.raises(DatasetError, match="truncated"):
        Video(path).open()
    with pytest.raises(DatasetError, match="twice as wide"):
        Video(video(tmp_path / "square.mp4", 3, size=(64, 48))).open()


def test_the_decoder_does_not_add_its_own_lines(tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(video(tmp_path / "w.mp4").read_bytes()[:400])
    command = [sys.executable, "-m", "panobench.cli.main", "view", str(path), "-o", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)  # FFmpeg decides once per process what it prints
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert "v.mp4: the video cannot be opened" in done.stderr


def test_damage_is_said_once_it_was_met(tmp_path: Path) -> None:
    whole = video(tmp_path / "w.mp4", 40).read_bytes()
    path = tmp_path / "v.mp4"
    index = whole.index(b"\x00\x00\x01\xb6", len(whole) // 3)  # a frame begins
    path.write_bytes(whole[: index + 4] + bytes(60) + whole[index + 64 :])
    sequence = Video(path).open()
    assert sequence.remarks() == []
    assert len([sequence.image(i) for i in range(len(sequence))]) == 40
    assert any("damaged" in remark for remark in sequence.remarks())


@pytest.mark.data
def test_corridor_clip() -> None:
    path = Path(os.environ.get("PANOBENCH_TEST_DATA", "/nonexistent"), "video/lab_corridor.mp4")
    if not path.is_file():
        pytest.skip("PANOBENCH_TEST_DATA has no video/lab_corridor.mp4")
    sequence = open_sequence("video", None, path, 256)
    images = [frame.image for frame in sequence.frames()]
    assert len(images) == 58
    for index in (57, 2, 40, 39, 56, 0):
        np.testing.assert_array_equal(sequence.image(index), images[index])

"""What folders hold besides the data, and files that differ in their ending alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from panobench.datasets.files.listing import by_stem, children, one_of_each
from panobench.datasets.formats.folder import find_sequences
from panobench.datasets.formats.synpano import scene_names
from panobench.datasets.formats.video import video_files
from panobench.datasets.palvio.dataset import Palvio
from panobench.errors import DatasetError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_shadows_of_macos_are_no_data(tmp_path: Path) -> None:
    touch(tmp_path, "walk10.mp4", "walk2.mp4", "._walk2.mp4", ".DS_Store", "__MACOSX/._walk2.mp4")
    assert list(video_files(tmp_path)) == ["walk2", "walk10"]
    assert [p.name for p in children(tmp_path)] == ["walk2.mp4", "walk10.mp4"]
    touch(tmp_path / "scenes", "room/images/1.png", "__MACOSX/images/._1.png", "__MACOSX/frames.csv", "a/frames.csv")
    assert scene_names(tmp_path / "scenes", "synpano") == ["room"]
    assert find_sequences(tmp_path / "scenes") == ["a"]
    touch(tmp_path / "bags", "ID01.bag", "._ID01.bag")
    assert Palvio(tmp_path / "bags").sequences() == ["ID01"]


def test_two_files_of_one_stem_keep_their_endings(tmp_path: Path) -> None:
    touch(tmp_path, "walk.mp4", "walk.mov", "other.mp4")
    assert sorted(video_files(tmp_path)) == ["other", "walk.mov", "walk.mp4"]
    assert video_files(tmp_path)["walk.mov"].name == "walk.mov"
    assert by_stem([Path("a.x"), Path("b.x")]) == {"a": Path("a.x"), "b": Path("b.x")}


def test_one_frame_in_two_formats_is_refused(tmp_path: Path) -> None:
    assert one_of_each([Path("a.png"), Path("b.png")]) == [Path("a.png"), Path("b.png")]
    with pytest.raises(DatasetError, match=r"a.jpg and a.png are the same frame twice\? keep one of them"):
        one_of_each([tmp_path / "a.jpg", tmp_path / "a.png"])

"""What a path is taken for, and what is said where it is nothing that is read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from panobench.datasets.inspection.guess import guess
from panobench.errors import DatasetError


def touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


@pytest.mark.parametrize(
    ("files", "dataset", "what"),
    [
        (["a.png", "b.png"], "images", "a folder of 2 images"),
        (["images/a.jpg"], "images", "a folder of 1 images"),
        (["one/a.jpg", "two/a.jpg", "__MACOSX/one/._a.jpg"], "images", "2 folders of images"),
        (["frames.csv", "camera.yaml", "images/a.png"], "folder", "a panobench sequence"),
        (["x/frames.csv", "y/frames.csv"], "folder", "2 panobench sequences"),
        (["groundtruth.txt", "images/a.png"], "synpano", "a SynPano scene"),
        (["a.bag", "._a.bag"], "bag", "a bag"),
        (["a.bag", "palvio.yaml"], "palvio", "a bag"),
        (["walk/metadata.yaml", "walk/walk_0.db3", "talk/talk_0.mcap"], "bag", "2 bags"),
        (["mav0/cam0/data.csv"], "tum-vi", "a recording in TUM-VI's layout"),
        (["transform.json", "images/a.png"], "omniblender", "a scene of OmniBlender"),
        (["transforms.json", "images/a.png"], "nerfstudio", "a project of nerfstudio"),
        (["transforms_train.json", "train/a.png"], "nerfstudio", "a project of nerfstudio"),
        (["sparse/0/cameras.bin", "sparse/0/images.bin", "images/a.png"], "colmap", "a COLMAP project"),
        (["cameras.txt", "images.txt", "points3D.txt"], "colmap", "a COLMAP project"),
        (["walk.mp4", "talk.mov", ".DS_Store"], "video", "2 videos"),
        (["walk.mp4", "dual_fisheye.yaml"], "insta360-dual-fisheye", "a video of two fisheye lenses"),
        (["walk.360", "dual_fisheye.yaml"], "video", "a video"),
    ],
)
def test_folders(tmp_path: Path, files: list[str], dataset: str, what: str) -> None:
    found = guess(touch(tmp_path, *files))
    assert (found.dataset, found.what, found.root) == (dataset, what, tmp_path)


@pytest.mark.parametrize(
    ("file", "dataset"),
    [
        ("w.MP4", "video"),
        ("w.insv", "video"),
        ("w.bag", "bag"),
        ("w.mcap", "bag"),
        ("w.DB3", "bag"),
        ("transforms.json", "nerfstudio"),
    ],
)
def test_files(tmp_path: Path, file: str, dataset: str) -> None:
    assert guess(touch(tmp_path, file) / file).dataset == dataset


def test_a_recording_of_tum_is_no_synpano_scene(tmp_path: Path) -> None:
    touch(tmp_path, "rgb/1.png", "depth/1.png")
    (tmp_path / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n1305031098.6 1 1 1 0 0 0 1\n")
    assert (guess(tmp_path).dataset, guess(tmp_path).what) == ("images", "a folder of 1 images")
    (tmp_path / "groundtruth.txt").write_text("0 1.png 1 1 1 0 0 0 1\n")
    assert guess(tmp_path).dataset == "synpano"


def test_pictures_that_are_not_read_are_named(tmp_path: Path) -> None:
    touch(tmp_path, "IMG_1.HEIC", "IMG_2.HEIC", "IMG_3.dng", "._IMG_4.HEIC")
    with pytest.raises(DatasetError, match=r"2 \.heic files, 1 \.dng files: these are not read; convert them to JPEG"):
        guess(tmp_path)


def test_an_archive_is_what_is_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_CACHE", str(tmp_path / "cache"))
    touch(tmp_path / "walk", "images/a.png", "images/b.png")
    path = Path(shutil.make_archive(str(tmp_path / "walk"), "zip", tmp_path, "walk"))
    found = guess(path)
    assert found.dataset == "images"
    assert found.what == f"an archive, unpacked to {found.root}: a folder of 2 images"


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("notes.txt", "nothing here that is read: images, a video, a bag"),
        ("a.png", "this is one image; name the folder of all, or look at it with `panobench view`"),
    ],
)
def test_what_is_nothing(tmp_path: Path, file: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        guess(touch(tmp_path, file) / file)
    with pytest.raises(DatasetError, match="no such file or folder"):
        guess(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="nothing here that is read"):
        guess(tmp_path / "empty")

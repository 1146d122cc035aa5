from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import panorama, save

from panobench.datasets.files.images import list_images
from panobench.datasets.files.natural import natural_names, natural_paths
from panobench.datasets.formats.omniblender import OmniBlender
from panobench.datasets.formats.synpano import SynPano
from panobench.external.imported import find_renders


@pytest.mark.parametrize(
    "ordered",
    [
        ["1.png", "2.png", "10.png", "11.png", "100.png"],
        ["frame_9.jpg", "frame_010.jpg", "frame_10.jpg", "frame_11.jpg"],
        ["a1_b9.png", "a1_b10.png", "a2_b1.png", "a10_b0.png"],
        ["0.25.png", "0.5.png", "1.125.png", "10.0.png"],  # times in seconds
        ["1403636579763555584.png", "1403636579813555456.png", "1403636580000000000.png"],
        ["IMG_20240101_235959.jpg", "IMG_20240102_000001.jpg"],
        ["9.png", "a.png", "b1.png", "b١.png"],  # an Arabic digit is text here
    ],
)
def test_numbers_sort_by_value(ordered: list[str]) -> None:
    shuffled = ordered[:]
    for seed in range(5):
        random.Random(seed).shuffle(shuffled)
        assert natural_names(shuffled) == ordered


def test_paths_sort_folder_by_folder() -> None:
    ordered = [Path("s2/1.png"), Path("s2/10.png"), Path("s10/2.png")]
    assert natural_paths(reversed(ordered)) == ordered


def test_images_and_scenes_without_leading_zeros(tmp_path: Path) -> None:
    for scene in ("s10", "s9"):
        for i in range(1, 13):
            save(tmp_path / scene / "images" / f"{i}.png", panorama(i))
    assert [p.stem for p in list_images(tmp_path / "s9/images")] == [str(i) for i in range(1, 13)]
    assert SynPano(tmp_path).sequences() == ["s9", "s10"]
    assert SynPano(tmp_path).open("s9").frame_name(9) == "10.png"


@pytest.mark.parametrize(
    ("listed", "expected"),
    [
        (["r_9.png", "r_10.png", "r_11.png"], ["r_9.png", "r_10.png", "r_11.png"]),
        (["r_10.png", "r_9.png", "r_11.png"], ["r_9.png", "r_10.png", "r_11.png"]),
        (["hall.png", "door2.png", "attic1.png"], ["hall.png", "door2.png", "attic1.png"]),  # numbers of nothing
    ],
)
def test_frames_of_a_list_go_by_their_numbers_or_by_the_list(
    listed: list[str], expected: list[str], tmp_path: Path
) -> None:
    frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()} for name in listed]
    for i, name in enumerate(listed):
        save(tmp_path / "images" / name, panorama(i))
    (tmp_path / "transform.json").write_text(json.dumps({"frames": frames}))
    sequence = OmniBlender(tmp_path).open()
    assert [sequence.frame_name(k) for k in range(3)] == expected


@pytest.mark.parametrize("name", ["{}.png", "render_{}.jpg", "run2_frame{:02d}.png"])
@pytest.mark.parametrize("first", [0, 1])
def test_renders_are_found_by_number_with_or_without_zeros(name: str, first: int, tmp_path: Path) -> None:
    for i in range(4):
        save(tmp_path / "scene/images" / f"{i:06d}.png", panorama(i))
    sequence = SynPano(tmp_path / "scene").open()
    for i in range(4):
        save(tmp_path / "renders" / name.format(i + first), panorama(i))
    for index in ([0, 1, 2, 3], [1, 2, 3], [3]):
        found = find_renders(tmp_path / "renders", index, sequence)
        assert [p.name for p in found] == [name.format(i + first) for i in index]

"""Masks as people paint, erase, label and name them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip

from panobench.datasets.formats.folder import Folder
from panobench.datasets.formats.image_folder import ImageFolder
from panobench.datasets.formats.video import Video
from panobench.errors import DatasetError
from panobench.masks.files import read_mask_file
from panobench.masks.pixels import understand

SIZE = (128, 64)
SEEN = np.ones((64, 128), bool)
SEEN[48:, 20:90] = False
rng = np.random.default_rng(0)
PHOTO = rng.integers(30, 220, (64, 128, 3)).astype(np.uint8)


def alpha(colours: np.ndarray | int, opaque: np.ndarray) -> np.ndarray:
    """BGRA: ``colours`` where ``opaque``, nothing elsewhere."""
    picture = np.zeros((64, 128, 4), np.uint8)
    picture[..., :3] = colours if not isinstance(colours, np.ndarray) or colours.ndim == 3 else colours[..., None]
    picture[..., 3] = np.where(opaque, 255, 0)
    return picture


RED = np.full((64, 128, 3), (20, 30, 230), np.uint8)
SPOT = np.zeros_like(SEEN)
SPOT[:8, :8] = True
MASKS = {
    "black on white": (SEEN * np.uint8(255), ""),
    "sixteen bits": (SEEN * np.uint16(65535), ""),
    "labels 0 and 1": (SEEN * np.uint8(1), "0 is hidden, 1 is seen"),
    "labels in sixteen bits": (SEEN * np.uint16(1), "0 is hidden, 1 is seen"),
    "255 in sixteen bits": (SEEN * np.uint16(255), ""),
    "dark grey": (SEEN * np.uint8(100), "0 is hidden, 100 is seen"),
    "light grey": (np.where(SEEN, 255, 150).astype(np.uint8), "150 is hidden, 255 is seen"),
    "a class of a palette": (np.dstack([0 * SEEN, 0 * SEEN, SEEN * 128]).astype(np.uint8), ""),
    "red on white": (np.where(SEEN[..., None], np.uint8(255), RED), "what is painted in colour is hidden"),
    "red on black": (np.where(SEEN[..., None], np.uint8(0), RED), "what is painted in colour is hidden"),
    "an erased photograph": (alpha(PHOTO, SEEN), "transparent pixels are hidden"),
    "erased white": (alpha(255, SEEN), "transparent pixels are hidden"),
    "painted black on nothing": (alpha(0, ~SEEN), "what is painted black is hidden"),
    "painted red on nothing": (alpha(RED, ~SEEN), "what is painted is hidden"),
    "a mask with a hole": (alpha(SEEN * np.uint8(255), ~SPOT), "black and transparent pixels are hidden"),
    "opaque everywhere": (alpha(SEEN * np.uint8(255), np.ones_like(SEEN)), ""),
}  # fmt: skip


@pytest.mark.parametrize("name", MASKS)
def test_what_is_hidden_is_understood(name: str, tmp_path: Path) -> None:
    picture, meaning = MASKS[name]
    path = tmp_path / "mask.png"
    assert cv2.imwrite(str(path), picture)
    found = read_mask_file(path, SIZE)
    expected = SEEN & ~SPOT if name == "a mask with a hole" else SEEN
    np.testing.assert_array_equal(found.valid, expected)
    assert found.remarks == ((f"mask mask.png: {meaning}",) if meaning else ())


def test_jpeg_masks_and_masks_of_another_size(tmp_path: Path) -> None:
    path = tmp_path / "mask.jpg"
    cv2.imwrite(str(path), SEEN * np.uint8(255))
    found = read_mask_file(path, SIZE)
    assert (found.valid == SEEN).mean() > 0.98
    half = read_mask_file(path, (64, 32))
    assert half.valid.shape == (32, 64)
    assert "scaled from 128x64 to the images' 64x32" in half.remarks[-1]
    rounded = read_mask_file(path, (128, 65))
    assert rounded.valid.shape == (65, 128)
    with pytest.raises(DatasetError, match=r"the mask is 128x64 pixels, the images are 64x128: it has to be that"):
        read_mask_file(path, (64, 128))


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((64, 128), np.uint8), "hides all of the view"),
        (np.ones((64, 128), np.uint8), "hides all of the view"),
        ((np.arange(128 * 64) % 19).reshape(64, 128).astype(np.uint8), "labels 0 to 18"),
        (alpha(255, np.zeros_like(SEEN)), "transparent everywhere"),
    ],
)
def test_what_cannot_be_a_mask_is_refused_in_a_line(picture: np.ndarray, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), picture)
    with pytest.raises(DatasetError, match=message):
        read_mask_file(path, SIZE)


def test_masks_that_hide_nothing_or_nearly_all_are_doubted() -> None:
    assert "hides nothing" in understand(np.full((64, 128), 255, np.uint8)).doubts[0]
    inverted = understand(~SEEN * np.uint8(255))
    assert "is it inverted?" in inverted.doubts[0]
    assert understand(SEEN * np.uint8(255)).doubts == ()
    with pytest.raises(ValueError, match="float32"):
        understand(np.zeros((4, 4), np.float32))


def fog(index: int, size: tuple[int, int]) -> np.ndarray:
    """Nothing that tells whether it is a panorama."""
    return np.full((size[1], size[0], 3), 90, np.uint8)


def picture(path: Path) -> Path:
    assert cv2.imwrite(str(path), SEEN * np.uint8(255))
    return path


@pytest.mark.parametrize(
    "name",
    [
        *("walk_mask.png", "walk-mask.png", "walkmask.png", "Walk.Mask.PNG"),
        *("walk.mp4.mask.png", "mask_walk.jpg", "mask.png"),
    ],
)
def test_nearly_right_names_are_used_and_said(name: str, tmp_path: Path) -> None:
    clip(tmp_path / "walk.mp4", [0, 0.1], size=SIZE, frame=fog)
    picture(tmp_path / name)
    sequence = Video(tmp_path / "walk.mp4").open()
    assert (sequence.camera.valid_mask() == SEEN).mean() > 0.98
    assert sequence.remarks() == [f"mask {name} is used; its usual name is walk.mask.png"]
    assert sequence.provenance()["mask"]["file"] == name


def test_the_right_name_counts_before_others_and_several_others_are_refused(tmp_path: Path) -> None:
    clip(tmp_path / "walk.mp4", [0, 0.1], size=SIZE, frame=fog)
    picture(tmp_path / "walk_mask.png")
    picture(tmp_path / "walk-mask.png")
    with pytest.raises(DatasetError, match=r"several pictures may be the mask \(walk-mask.png, walk_mask.png\)"):
        Video(tmp_path / "walk.mp4").open()
    picture(tmp_path / "walk.mask.png")
    sequence = Video(tmp_path / "walk.mp4").open(width=64)
    assert sequence.remarks() == []
    assert sequence.camera.valid_mask().shape == (32, 64)


def test_pictures_that_are_masks_of_something_else_are_named(tmp_path: Path) -> None:
    for name in ("walk.mp4", "run.mp4"):
        clip(tmp_path / name, [0, 0.1], size=SIZE, frame=fog)
    picture(tmp_path / "mask.png")  # of which?
    sequence = Video(tmp_path / "walk.mp4").open()
    assert sequence.camera.mask is None
    assert sequence.remarks() == ["mask.png is not used: a mask is called walk.mask.png, or given by --mask"]
    (tmp_path / "mask.png").rename(tmp_path / "run_painted-mask.png")  # the other's
    assert Video(tmp_path / "walk.mp4").open().remarks() == []
    assert "run_painted-mask.png is not used" in Video(tmp_path / "run.mp4").open().remarks()[0]


def test_folders_of_images(tmp_path: Path) -> None:
    for i in range(3):
        (tmp_path / "walk").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "walk" / f"{i}.png"), PHOTO)
    picture(tmp_path / "walk" / "Mask.png")
    sequence = ImageFolder(tmp_path / "walk").open()
    assert len(sequence) == 3
    np.testing.assert_array_equal(sequence.camera.valid_mask(), SEEN)
    assert any("usual name is mask.png" in remark for remark in sequence.remarks())
    (tmp_path / "walk" / "Mask.png").unlink()
    (tmp_path / "walk" / "masks").mkdir()
    picture(tmp_path / "walk/masks/0.png")
    assert any("masks of single frames are not read" in r for r in ImageFolder(tmp_path / "walk").open().remarks())


def test_a_sequence_of_our_own(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"images/{i}.png"), PHOTO)
    (tmp_path / "frames.csv").write_text("time,file\n0,images/0.png\n1,images/1.png\n")
    (tmp_path / "camera.yaml").write_text("model: erp\nwidth: 128\nheight: 64\nmask: rim.png\n")
    cv2.imwrite(str(tmp_path / "rim.png"), SEEN * np.uint8(1))  # labels here, too
    np.testing.assert_array_equal(Folder(tmp_path).open().camera.valid_mask(), SEEN)
    cv2.imwrite(str(tmp_path / "mask.png"), alpha(PHOTO, ~SPOT))
    sequence = Folder(tmp_path).open()
    np.testing.assert_array_equal(sequence.camera.valid_mask(), SEEN & ~SPOT)
    assert sequence.remarks() == ["mask mask.png: transparent pixels are hidden"]

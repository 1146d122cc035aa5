"""Masks of single frames: what comes back, and what they cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.masks.files import read_mask_file
from panobench.masks.frame_masks import FrameMasks, write_frame_masks

ROWS, COLUMNS = np.mgrid[:256, :512]


def moving_disc(index: int) -> np.ndarray:
    return (ROWS - 128) ** 2 + (COLUMNS - 8 * index) ** 2 > 40**2


def test_masks_come_back_as_they_were_and_are_small(tmp_path: Path) -> None:
    masks = FrameMasks()
    for index in (3, 40):
        masks.put(index, moving_disc(index))
    assert sorted(masks) == [3, 40]
    assert np.array_equal(masks[40], moving_disc(40))
    assert masks[40].dtype == np.bool_
    with pytest.raises(KeyError):
        masks[4]
    write_frame_masks(tmp_path / "masks", masks)
    files = sorted((tmp_path / "masks").iterdir())
    assert [f.name for f in files] == ["000003.png", "000040.png"]
    assert all(f.stat().st_size < 600 for f in files)
    assert np.array_equal(read_mask_file(files[0], (512, 256)).valid, moving_disc(3))


def test_a_later_mask_of_a_frame_replaces_the_first() -> None:
    masks = FrameMasks()
    masks.put(0, moving_disc(0))
    masks.put(0, moving_disc(5))
    assert len(masks) == 1
    assert np.array_equal(masks[0], moving_disc(5))


def test_no_masks_make_no_folder(tmp_path: Path) -> None:
    write_frame_masks(tmp_path / "masks", {})
    assert not (tmp_path / "masks").exists()

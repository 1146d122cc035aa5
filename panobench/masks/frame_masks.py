"""Masks of single frames, kept small: a sequence of thousands of frames may have as many."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


class FrameMasks(Mapping[int, Mask]):
    """Masks (H, W) by frame index, each kept as a PNG of one bit per pixel: some hundred bytes at 512 x 256."""

    def __init__(self) -> None:
        self._pictures: dict[int, bytes] = {}

    def put(self, index: int, mask: Mask) -> None:
        """The mask (H, W) of a frame, in place of one it may have."""
        self._pictures[index] = encode_mask(mask)

    def __getitem__(self, index: int) -> Mask:
        picture = cv2.imdecode(np.frombuffer(self._pictures[index], np.uint8), cv2.IMREAD_GRAYSCALE)
        return np.asarray(picture, np.uint8) > 0

    def __contains__(self, index: object) -> bool:
        return index in self._pictures

    def picture(self, index: int) -> bytes:
        """A frame's mask as ``encode_mask`` writes it."""
        return self._pictures[index]

    def __iter__(self) -> Iterator[int]:
        return iter(self._pictures)

    def __len__(self) -> int:
        return len(self._pictures)


def encode_mask(mask: Mask) -> bytes:
    """A mask (H, W) as a PNG of one bit per pixel, white where it is True."""
    _, data = cv2.imencode(
        ".png", mask.astype(np.uint8) * 255, [cv2.IMWRITE_PNG_BILEVEL, 1, cv2.IMWRITE_PNG_COMPRESSION, 9]
    )
    return bytes(data)


def mask_name(index: int) -> str:
    """The file name of a frame's mask."""
    return f"{index:06d}.png"


def write_frame_masks(folder: Path, masks: Mapping[int, Mask]) -> None:
    """One picture for each mask; no folder without any. Raises OSError."""
    if masks:
        folder.mkdir(exist_ok=True)
    for index in masks:
        picture = masks.picture(index) if isinstance(masks, FrameMasks) else encode_mask(masks[index])
        (folder / mask_name(index)).write_bytes(picture)

"""Rows of labelled pictures on one sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.images import resize_image

_BACKGROUND, _INK, _FAINT = (24, 26, 30), (235, 235, 235), (150, 155, 165)
_GAP, _LABEL = 12, 26
#: Grey level where a camera sees nothing.
_UNSEEN = (46, 49, 56)
Picture = tuple[NDArray[np.uint8], str]


@dataclass(frozen=True)
class Cell:
    """A picture (H, W, 3) with a label below it. valid: (H, W) False where the camera sees nothing; drawn grey."""

    image: NDArray[np.uint8]
    label: str
    valid: NDArray[np.bool_] | None = None


def contact_sheet(
    rows: list[list[Cell]], title: str, cell_height: int = 240, max_width: int = 1800
) -> NDArray[np.uint8]:
    """A dark sheet (H, W, 3) with a title and rows of cells, all at one height; long rows are broken."""
    lines = [line for row in rows for line in _broken([_fit(c, cell_height, max_width) for c in row], max_width)]
    width = max(_GAP + sum(picture.shape[1] + _GAP for picture, _ in line) for line in lines)
    width = max(width, 20 + 12 * len(title))
    sheet = np.empty((44 + len(lines) * (cell_height + _LABEL + _GAP), width, 3), np.uint8)
    sheet[:] = _BACKGROUND
    _write(sheet, title, _GAP, 29, _INK, 0.6)
    y = 44
    for line in lines:
        x = _GAP
        for picture, text in line:
            h, w = picture.shape[:2]
            sheet[y : y + h, x : x + w] = picture
            room = max(4, w // 8)
            _write(sheet, text if len(text) <= room else text[: room - 2] + "..", x, y + cell_height + 17, _FAINT, 0.42)
            x += w + _GAP
        y += cell_height + _LABEL + _GAP
    return sheet


def _broken(row: list[Picture], max_width: int) -> list[list[Picture]]:
    """A row broken into lines no wider than ``max_width``."""
    lines: list[list[Picture]] = [[]]
    x = _GAP
    for picture in row:
        w = picture[0].shape[1] + _GAP
        if lines[-1] and x + w > max_width:
            lines.append([])
            x = _GAP
        lines[-1].append(picture)
        x += w
    return lines


def shade_unseen(image: NDArray[np.uint8], valid: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """``image`` with a plain dark grey where ``valid`` is False."""
    if valid is None or valid.all():
        return image
    return np.where(valid[..., None], image, np.array(_UNSEEN, np.uint8))


def _fit(cell: Cell, height: int, max_width: int) -> Picture:
    """The cell's picture at ``height``, lower if it would be too wide, and its label."""
    image = shade_unseen(cell.image, cell.valid)
    h, w = image.shape[:2]
    scale = min(height / h, (max_width - 2 * _GAP) / w)
    return resize_image(image, max(1, round(w * scale)), min(height, max(1, round(h * scale)))), cell.label


def _write(sheet: NDArray[np.uint8], text: str, x: int, y: int, colour: tuple[int, int, int], scale: float) -> None:
    import cv2

    plain = text.encode("ascii", "replace").decode()  # OpenCV's fonts have no other letters
    cv2.putText(sheet, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)

"""Two streams of one recording, or its two files, as one picture: what cameras with two lenses write."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.trajectory_match import nearest
from panobench.errors import DatasetError
from panobench.video.container import open_container, picture_streams
from panobench.video.reader import VideoReader
from panobench.video.recording import Recording

#: Frames of the two whose times differ by more than this share of the interval were not taken together.
_APART = 0.5
#: Insta360's two files of a recording: VID_..._00_... has one lens, VID_..._10_... the other.
_LENS = re.compile(r"^(.*)_(00|10)_(\d+)$")


class PairReader:
    """Frames of two streams, beside each other, or for strips of three faces (GoPro) one below the other.

    A strip that is wider than three squares has its lenses' overlap twice, in the middle of the outer faces: it is
    mixed there. Times are those of the first stream; frames of the second are the nearest in time.
    """

    def __init__(self, first: Path, second: Path | None = None) -> None:
        self.path = first
        self.first = VideoReader(first, 0)
        self.second = VideoReader(first, 1) if second is None else VideoReader(second, 0)
        self.single = (self.first.width, self.first.height)
        if (self.second.width, self.second.height) != self.single:
            raise DatasetError(
                f"its two lenses have pictures of {self.single[0]}x{self.single[1]} and "
                f"{self.second.width}x{self.second.height} pixels",
                first,
            )
        self.strips = is_strip(self.single)
        self.width = 3 * self.single[1] if self.strips else 2 * self.single[0]
        self.height = (2 if self.strips else 1) * self.single[1]
        self.index, self.orientation = self.first.index, self.first.orientation
        self.side_data = self.first.side_data
        one, other = self.first.index.clock, self.second.index.clock
        partner = nearest(other, one)
        together = np.abs(other[partner] - one) <= _APART / self.first.rate
        if not together.any():
            raise DatasetError("the frames of its two lenses were not taken at the same times", first)
        self._frames = list(zip(np.flatnonzero(together).tolist(), partner[together].tolist()))
        self.times = self.first.times[together]

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def rate(self) -> float:
        """As ``VideoReader.rate``."""
        return self.first.rate

    @property
    def missing(self) -> list[int]:
        """Frames of which one lens's picture cannot be decoded, as far as they were read."""
        a, b = set(self.first.missing), set(self.second.missing)
        return [k for k, (i, j) in enumerate(self._frames) if i in a or j in b]

    @property
    def flawed(self) -> list[int]:
        """Frames of which the decoder patched up a picture."""
        a, b = set(self.first.flawed), set(self.second.flawed)
        return [k for k, (i, j) in enumerate(self._frames) if i in a or j in b]

    @property
    def overlapping(self) -> bool:
        """Whether strips have their lenses' overlap twice."""
        return self.strips and self.single[0] > 3 * self.single[1]

    def files(self) -> list[Path]:
        """The files read."""
        return list(dict.fromkeys([self.first.path, self.second.path]))

    def read(self, index: int, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """As ``VideoReader.read``, of both."""
        i, j = self._frames[index]
        width, height = size or (self.width, self.height)
        if self.strips:
            each = (max(1, round(self.single[0] * width / self.width)), max(1, round(height / 2)))
            rows = [even_strip(self.first.read(i, each), width), even_strip(self.second.read(j, each), width)]
            joined = np.concatenate(rows)
        else:
            each = (max(1, round(width / 2)), height)
            joined = np.concatenate([self.first.read(i, each), self.second.read(j, each)], axis=1)
        if joined.shape[1::-1] == (width, height):
            return joined
        return np.asarray(cv2.resize(joined, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def is_strip(size: tuple[int, int]) -> bool:
    """Whether pictures are three squares beside each other, with some overlap."""
    return 2.98 <= size[0] / size[1] <= 3.2


def open_recording(path: Path) -> Recording:
    """A reader of both lenses of a recording that has them apart, in two streams or in two files; else of the video."""
    with open_container(path) as container:
        streams = picture_streams(container, path)
        sizes = [(s.codec_context.width, s.codec_context.height) for s in streams[:2]]
    square = sizes[0][0] == sizes[0][1]
    if len(sizes) > 1 and sizes[0] == sizes[1] and (square or is_strip(sizes[0])):
        return PairReader(path)
    partner = other_lens(path)
    if square and partner is not None:
        return PairReader(*sorted((path, partner)))
    return VideoReader(path)


def other_lens(path: Path) -> Path | None:
    """The file of the other lens of a recording in two files, if it is there."""
    match = _LENS.match(path.stem)
    if match is None:
        return None
    other = path.with_name(f"{match[1]}_{'10' if match[2] == '00' else '00'}_{match[3]}{path.suffix}")
    return other if other.is_file() else None


def is_second_lens(path: Path) -> bool:
    """Whether a file is read along with another one, that of the first lens."""
    match = _LENS.match(path.stem)
    return match is not None and match[2] == "10" and other_lens(path) is not None


def even_strip(strip: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """A strip (h, w, 3) of three faces as (h, width, 3), the overlaps in its outer faces mixed.

    The strip has ``w - 3 h`` pixels more than three squares, half of them at each overlap. There it has both lenses'
    pictures of the same directions beside each other, each twice that half wide, which stand for three times that half.
    """
    h, w = strip.shape[:2]
    extra = (w - 3 * h) / 2
    if extra < 0.5:
        return strip if w == width else np.asarray(cv2.resize(strip, (width, h), interpolation=cv2.INTER_AREA))
    x = (np.arange(width) + 0.5) * 3 * h / width
    one, share = x.copy(), np.zeros(width)
    half = 1.5 * extra
    for k, middle in enumerate((0.5 * h, 2.5 * h)):
        along = (x - (middle - half)) / (2 * half)
        one = np.where(along >= 1, x + (k + 1) * extra, one)
        inside = (along >= 0) & (along < 1)
        one = np.where(inside, middle - half + (k + 2 * along) * extra, one)
        share = np.where(inside, along, share)
    other = one + np.where(share > 0, 2 * extra, 0.0)
    rows = np.repeat(np.arange(h, dtype=np.float32)[:, None], width, axis=1)

    def taken(columns: NDArray[np.float64]) -> NDArray[np.float64]:
        at = np.repeat((columns - 0.5).astype(np.float32)[None, :], h, axis=0)
        return np.asarray(cv2.remap(strip, at, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=float)

    mixed = (1 - share)[None, :, None] * taken(one) + share[None, :, None] * taken(other)
    return np.asarray(np.rint(mixed), dtype=np.uint8)

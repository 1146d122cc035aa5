"""Frames of a video by their number, whatever order they are asked for in."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.images import check_limits
from panobench.errors import DatasetError
from panobench.video.container import bound_decoder, frames, jump, open_container, picture_streams, side_data
from panobench.video.index import FrameIndex, index_frames
from panobench.video.orientation import Orientation

#: Gaps of up to this many frames are decoded through rather than jumped over.
_DECODE_AHEAD = 48


class VideoReader:
    """One stream of pictures. Frame i is the i-th one shown; in order, each frame is decoded once. Thread-safe.

    times: (N,) seconds after the first frame, from presentation stamps. width, height: of the pictures as they are to
    be shown, turned as the container says. side_data: what else it says of them. stream: 0 is the largest picture.
    Raises DatasetError for a file that does not open or has no frame.
    """

    def __init__(self, path: Path, stream: int = 0) -> None:
        self.path, self.stream = path, stream
        self._lock = threading.Lock()
        self.index: FrameIndex = index_frames(path, stream)
        self.times = self.index.times
        self._missing: set[int] = set()
        self._flawed: set[int] = set()
        self._container: Any = None
        self._source: Iterator[tuple[int, Any]] = iter(())
        self._held: tuple[int, Any] | None = None  # decoded and not yet asked for
        self._last: tuple[int, Any] | None = None  # decoded last before that
        self._open_at(None)
        first = self._find(0)
        self.side_data = side_data(first)
        self.orientation = Orientation.from_matrix(self.side_data.get("DISPLAYMATRIX", b""))
        self._stored = (int(first.width), int(first.height))
        self.width, self.height = self.orientation.size(*self._stored)
        check_limits(self.width, self.height, path)

    def __len__(self) -> int:
        return len(self.times)

    def files(self) -> list[Path]:
        """The files read."""
        return [self.path]

    @property
    def rate(self) -> float:
        """Frames per second: one over the median interval (1 for a single frame)."""
        return float(1.0 / np.median(np.diff(self.times))) if len(self) > 1 else 1.0

    @property
    def missing(self) -> list[int]:
        """Frames found so far that cannot be decoded; reading one gives the nearest that can, earlier ones first."""
        return sorted(self._missing)

    @property
    def flawed(self) -> list[int]:
        """Frames read so far that the decoder patched up."""
        return sorted(self._flawed)

    def read(self, index: int, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """Frame ``index`` as RGB (H, W, 3), ``size`` (width, height) pixels (None: as it is). Raises IndexError."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        with self._lock:
            return self._convert(self._find(index), size or (self.width, self.height), index)

    def _convert(self, frame: Any, size: tuple[int, int], index: int) -> NDArray[np.uint8]:
        import av
        from av.video.reformatter import ColorRange, Interpolation

        if (frame.width, frame.height) != self._stored:
            raise DatasetError(
                f"the frame is {frame.width}x{frame.height}, the video {self._stored[0]}x{self._stored[1]}",
                self.path,
                frame=index,
            )
        width, height = self.orientation.size(*size)
        shrinks = width <= frame.width and height <= frame.height
        # Without the last two flags FFmpeg rounds down and gives two columns one colour.
        how = (Interpolation.AREA if shrinks else Interpolation.BILINEAR).value
        how |= Interpolation.ACCURATE_RND.value | Interpolation.FULL_CHR_H_INT.value
        try:
            rgb = frame.reformat(width, height, "rgb24", interpolation=how, dst_color_range=ColorRange.JPEG.value)
        except (av.error.FFmpegError, OSError, ValueError):
            raise DatasetError(f"pixels of format {frame.format.name} are not read", self.path, frame=index) from None
        return self.orientation.apply(np.asarray(rgb.to_ndarray(), dtype=np.uint8))

    def _find(self, index: int) -> Any:
        """The decoded frame, or the nearest one before it that can be decoded."""
        while True:
            index = self._standing_in(index)
            if self._last is not None and self._last[0] == index:
                return self._last[1]
            if not self._reachable(index):
                self._open_at(self._key(index))
            frame = self._advance_to(index)
            if frame is None and self._last is None:
                frame = self._from_earlier(index)
            if frame is not None:
                if frame.is_corrupt:
                    self._flawed.add(index)
                return frame
            # The decoder went past it: neither it nor its neighbours up to the next one that came can be had.
            begin = 0 if self._last is None else self._last[0] + 1
            self._missing.update(range(begin, len(self) if self._held is None else self._held[0]))
            self._missing.add(index)

    def _standing_in(self, index: int) -> int:
        """``index``, or for a frame that is known to be missing the nearest one that is not, earlier ones first."""
        if index not in self._missing:
            return index
        for other in (*range(index - 1, -1, -1), *range(index + 1, len(self))):
            if other not in self._missing:
                return other
        raise DatasetError("no frame of the video can be decoded: it is damaged", self.path)

    def _reachable(self, index: int) -> bool:
        """Whether decoding on from here comes to ``index``, and no later than from its keyframe."""
        if self._held is not None:
            ahead = self._held[0]
        else:
            ahead = 0 if self._last is None else self._last[0] + 1
        if index < ahead:
            return self._last is not None and self._last[0] < index  # passed over: it is not going to come
        key = self._key(index)
        return index - ahead <= _DECODE_AHEAD or key is None or key <= self.index.stamps[ahead]

    def _key(self, index: int) -> int | None:
        """Where to begin decoding for a frame: a keyframe's stamp, None for the start of the file."""
        return int(self.index.keys[index]) if index > 0 and not self.index.counted else None

    def _from_earlier(self, index: int) -> Any:
        """Decode from ever earlier places until frames before ``index`` come: a jump may have gone too far."""
        earlier = np.unique(self.index.keys[: index + 1])[::-1][:3].tolist()
        for key in (*(earlier if not self.index.counted else ()), None):
            self._open_at(key)
            frame = self._advance_to(index)
            if frame is not None or self._last is not None:
                return frame
        return None

    def _advance_to(self, index: int) -> Any:
        """Decode on to ``index`` and return its frame; None if it does not come. Later frames are kept."""
        while True:
            item = self._held or next(self._source, None)
            if item is None:
                return None
            if item[0] > index:
                self._held = item
                return None
            self._held, self._last = None, item
            if item[0] == index:
                return item[1]

    def _open_at(self, key: int | None) -> None:
        """Make the frame with stamp ``key``, or the file's first, the next one decoded."""
        if key is None or self._container is None:
            if self._container is not None:
                self._container.close()
            self._container = open_container(self.path)
        picture = picture_streams(self._container, self.path)[self.stream]
        if not picture.codec_context.is_open:
            bound_decoder(picture)
        if key is not None and not jump(self._container, picture, key):
            self._open_at(None)
            return
        self._source = self._numbered(picture)
        self._held = self._last = None

    def _numbered(self, picture: Any) -> Iterator[tuple[int, Any]]:
        """Frames with their numbers as they come; what the index does not know is passed over."""
        count, latest = 0, -1
        for frame in frames(self._container, picture):
            if self.index.counted:
                number, count = count, count + 1
            elif frame.pts is None:
                continue
            else:
                number = int(np.searchsorted(self.index.stamps, frame.pts))
                if number >= len(self) or self.index.stamps[number] != frame.pts:
                    continue
            if latest < number < len(self):
                latest = number
                yield number, frame

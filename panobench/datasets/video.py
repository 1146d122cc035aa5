"""360-degree videos: MP4 and whatever else OpenCV's FFmpeg decodes. No ground truth; time = frame / rate.

``<name>.mask.png`` beside the video (white = valid) hides the operator or the tripod.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.checksums import files_provenance
from panobench.datasets.image_sequence import scaled_camera
from panobench.datasets.images import check_limits, read_mask, resize_image
from panobench.datasets.locate import choose_sequence
from panobench.datasets.synpano import panorama_camera
from panobench.errors import DatasetError

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi", ".360", ".insv")
#: Gaps up to this many frames are crossed by decoding on, which is exact and often faster than seeking.
_DECODE_AHEAD = 48
#: A container's frame count may be a little too high; a file that ends earlier than this is truncated.
_COUNT_SLACK = 4


class VideoReader:
    """Frames of a video by index, (H, W, 3) RGB. Reading in order is one decode per frame; any order is correct.

    Thread-safe. Raises DatasetError for a file that does not open, has no usable rate, or ends early.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._capture = self._open()
        self._next = 0
        cv2 = _cv2()
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        check_limits(self.width, self.height, path)
        self.rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        if not (np.isfinite(self.rate) and 0 < self.rate <= 1000):
            raise DatasetError(f"the video claims {self.rate:g} frames per second", path)
        claimed = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.count = self._last_readable(claimed)

    def _open(self) -> Any:
        cv2 = _cv2()
        if self.path.stat().st_size == 0:
            raise DatasetError("the video is empty", self.path)
        # What FFmpeg and OpenCV would print about a damaged file, our own message says in one line.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        log = cv2.utils.logging
        log.setLogLevel(min(log.getLogLevel(), log.LOG_LEVEL_ERROR))
        capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise DatasetError("the video cannot be opened: not a video, truncated, or an unknown codec", self.path)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture

    def _last_readable(self, claimed: int) -> int:
        """The number of frames: ``claimed``, less the last few if they do not decode."""
        if claimed < 1:
            raise DatasetError("the video has no frame", self.path)
        for count in range(claimed, max(claimed - _COUNT_SLACK, 0), -1):
            if self._seek(count - 1) and self._grab():
                self._rewind()
                return count
        raise DatasetError(f"the video is truncated: its header promises {claimed} frames", self.path)

    def _rewind(self) -> None:
        self._capture.release()
        self._capture = self._open()
        self._next = 0

    def _grab(self) -> bool:
        ok = bool(self._capture.grab())
        self._next += ok
        return ok

    def _seek(self, index: int) -> bool:
        """Make ``index`` the next frame to be grabbed."""
        cv2 = _cv2()
        if not self._next <= index <= self._next + _DECODE_AHEAD:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            if int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) == index:
                self._next = index
            else:
                self._rewind()
        while self._next < index:
            if not self._grab():
                return False
        return True

    def read(self, index: int) -> NDArray[np.uint8]:
        """Frame ``index`` as RGB (H, W, 3)."""
        cv2 = _cv2()
        if not 0 <= index < self.count:
            raise IndexError(f"frame {index} of {self.count}")
        with self._lock:
            ok = self._seek(index) and self._grab()
            pixels = self._capture.retrieve()[1] if ok else None
        if pixels is None:
            raise DatasetError("the frame cannot be decoded; the video is damaged or truncated", self.path, frame=index)
        if pixels.shape[:2] != (self.height, self.width):
            raise DatasetError(
                f"the frame is {pixels.shape[1]}x{pixels.shape[0]}, the video {self.width}x{self.height}",
                self.path,
                frame=index,
            )
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _cv2() -> Any:
    import cv2

    return cv2


class VideoSequence(FrameSequence):
    """A video seen by ``native`` (its camera at the stored size), resized to ``width``."""

    def __init__(self, reader: VideoReader, native: Camera, name: str, width: int | None, dataset: str) -> None:
        self.reader, self.name, self.dataset = reader, name, dataset
        self.native = native
        self.camera = scaled_camera(native, width)
        self.times = np.arange(reader.count) / reader.rate

    def image(self, index: int) -> NDArray[np.uint8]:
        return resize_image(self.reader.read(range(len(self))[index]), self.camera.width, self.camera.height)

    def provenance(self) -> dict[str, Any]:
        return {
            "dataset": self.dataset,
            "sequence": self.name,
            "root": str(self.reader.path),
            "native_size": [self.reader.width, self.reader.height],
            "rate_hz": self.reader.rate,
            **files_provenance([self.reader.path]),
        }


def video_files(root: Path) -> dict[str, Path]:
    """Sequence name -> video file: ``root`` itself, or the videos in it. Raises DatasetError if there is none."""
    if root.is_file():
        return {root.stem: root}
    if not root.is_dir():
        raise DatasetError("no such file or folder", root)
    found = {p.stem: p for p in sorted(root.iterdir()) if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file()}
    if not found:
        raise DatasetError(f"no video here ({', '.join(VIDEO_SUFFIXES)})", root)
    return found


class Video(Dataset):
    """Equirectangular videos: ``root`` is a file, or a folder of them."""

    name = "video"

    def sequences(self) -> list[str]:
        if self.root is None:
            raise DatasetError("dataset 'video' needs --root FILE (or --root FOLDER --sequence NAME)")
        return list(video_files(self.root))

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name = choose_sequence(self.name, sequence, self.sequences())
        assert self.root is not None
        path = video_files(self.root)[name]
        reader = VideoReader(path)
        camera = panorama_camera((reader.width, reader.height), path)
        mask = path.with_name(f"{path.stem}.mask.png")
        if mask.is_file():
            camera = camera.with_mask(read_mask(mask, (reader.width, reader.height)))
        return VideoSequence(reader, camera, name, width, self.name)

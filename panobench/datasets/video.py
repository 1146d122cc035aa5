"""360-degree videos in any format that FFmpeg decodes. No ground truth; times are the frames' presentation stamps.

``<name>.mask.png`` beside the video (white = valid) hides the operator or the tripod.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.checksums import files_provenance
from panobench.datasets.image_sequence import scaled_camera
from panobench.datasets.listing import by_stem, children
from panobench.datasets.locate import choose_sequence
from panobench.datasets.synpano import panorama_camera
from panobench.errors import DatasetError
from panobench.masks.files import BesideMask, beside_video
from panobench.video.reader import VideoReader

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".360", ".insv", ".lrv", ".3gp", ".wmv", ".flv", ".ogv"),
    *(".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".mxf", ".h264", ".hevc"),
)


class VideoSequence(FrameSequence):
    """A video seen by ``native`` (its camera at the stored size), decoded at ``width``."""

    def __init__(
        self, reader: VideoReader, native: Camera, name: str, width: int | None, dataset: str, mask: BesideMask
    ) -> None:
        self.reader, self.name, self.dataset, self.mask = reader, name, dataset, mask
        self.native = native if mask.file is None else native.with_mask(mask.file.valid)
        self.camera = scaled_camera(self.native, width)
        self.times = reader.times

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.reader.read(range(len(self))[index], (self.camera.width, self.camera.height))

    def remarks(self) -> list[str]:
        return [*video_remarks(self.reader), *self.mask.remarks]

    def provenance(self) -> dict[str, Any]:
        return {
            "dataset": self.dataset,
            "sequence": self.name,
            "root": str(self.reader.path),
            **video_provenance(self.reader),
            **self.mask.about(),
            **files_provenance([self.reader.path, *self.mask.files()]),
        }


def video_provenance(reader: VideoReader) -> dict[str, Any]:
    """Size, rate and times of a video for run.json."""
    steps = np.diff(reader.times)
    return {
        "native_size": [reader.width, reader.height],
        "rate_hz": reader.rate,
        "interval_s": [float(steps.min()), float(steps.max())] if len(steps) else None,
        "orientation": reader.orientation.describe(),
    }


def video_remarks(reader: VideoReader) -> list[str]:
    """What is not as it should be with a video, as far as its frames have been read."""
    found = []
    count = len(reader)
    if reader.orientation:
        found.append(f"the video is shown {reader.orientation.describe()}, as its metadata say")
    if reader.index.assumed_rate is not None:
        found.append(f"the video has no time stamps: {reader.index.assumed_rate:g} frames per second are assumed")
    if reader.index.lost:
        found.append(f"{reader.index.lost} frames at the ends of the video cannot be decoded and are left out")
    if reader.missing:
        found.append(
            f"{len(reader.missing)} of {count} frames of the video are damaged and cannot be decoded "
            f"(the first is {reader.missing[0]}): the frame before stands in their place"
        )
    if reader.flawed:
        found.append(
            f"{len(reader.flawed)} of {count} frames of the video are damaged in part (first {reader.flawed[0]})"
        )
    return found


def video_files(root: Path) -> dict[str, Path]:
    """Sequence name -> video file: ``root`` itself, or the videos in it. Raises DatasetError if there is none.

    A name is the file's without its ending; with it where two files differ in that alone.
    """
    if root.is_file():
        return {root.stem: root}
    if not root.is_dir():
        raise DatasetError("no such file or folder", root)
    found = by_stem(p for p in children(root) if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file())
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
        mask = beside_video(path, (reader.width, reader.height))
        return VideoSequence(reader, camera, name, width, self.name, mask)

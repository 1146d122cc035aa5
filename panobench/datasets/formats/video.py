"""360-degree videos in any format that FFmpeg decodes, in any layout that ``panobench.layouts`` knows. No ground truth.

Times are the frames' presentation stamps. ``NAME.mask.png`` beside the video (white = valid) hides the operator.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import inspect_calibration, split_choice
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.files.checksums import files_provenance
from panobench.datasets.files.listing import by_stem, children
from panobench.datasets.formats.image_folder import for_size
from panobench.datasets.formats.image_sequence import scaled_camera
from panobench.datasets.locate import choose_sequence
from panobench.errors import DatasetError, UsageError
from panobench.layouts.reader import PanoramaReader, mask_of_panorama
from panobench.layouts.reader import panoramas as read_panoramas
from panobench.masks.files import BesideMask, beside_video
from panobench.video.pair import is_second_lens, open_recording
from panobench.video.reader import VideoReader
from panobench.video.recording import Recording

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".360", ".insv", ".lrv", ".3gp", ".wmv", ".flv", ".ogv"),
    *(".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".mxf", ".h264", ".hevc"),
)


class VideoSequence(FrameSequence):
    """A video as the pictures of one camera, decoded at ``width``: panoramas, or what a calibrated lens took."""

    def __init__(
        self, pictures: PanoramaReader | LensReader, name: str, width: int | None, dataset: str, mask: BesideMask
    ) -> None:
        self.pictures, self.name, self.dataset, self.mask = pictures, name, dataset, mask
        self.native = mask.on(pictures.camera())
        self.camera = scaled_camera(self.native, width)
        self.times = pictures.video.times

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.pictures.read(range(len(self))[index], (self.camera.width, self.camera.height))

    @property
    def enlargement(self) -> float:
        return max(1.0, self.camera.width / self.native.width)

    def remarks(self) -> list[str]:
        return [*video_remarks(self.pictures.video), *self.pictures.remarks(), *self.mask.remarks]

    def provenance(self) -> dict[str, Any]:
        video = self.pictures.video
        inputs = [*video.files(), *self.pictures.files(), *self.mask.files()]
        return {
            "dataset": self.dataset,
            "sequence": self.name,
            "root": str(video.path),
            **video_provenance(video),
            **self.pictures.about(),
            **self.mask.about(),
            **files_provenance(inputs),
        }


class LensReader:
    """Frames of ``video`` as a lens took them, by its calibration (`--calibration`)."""

    def __init__(self, video: Recording, calibration: str) -> None:
        path, _ = split_choice(calibration)
        self.video, self._calibration = video, path
        self._camera = for_size(inspect_calibration(calibration).camera, (video.width, video.height), path)

    def read(self, index: int, size: tuple[int, int]) -> NDArray[np.uint8]:
        """As ``PanoramaReader.read``."""
        return self.video.read(index, size)

    def camera(self) -> Camera:
        """The lens."""
        return self._camera

    def remarks(self) -> list[str]:
        """None."""
        return []

    def about(self) -> dict[str, Any]:
        """For a sequence's provenance."""
        return {"calibration": str(self._calibration)}

    def files(self) -> list[Path]:
        """The files read besides the video."""
        return [self._calibration]


def video_provenance(reader: Recording) -> dict[str, Any]:
    """Size, rate and times of a video for run.json."""
    steps = np.diff(reader.times)
    return {
        "native_size": [reader.width, reader.height],
        "rate_hz": reader.rate,
        "interval_s": [float(steps.min()), float(steps.max())] if len(steps) else None,
        "orientation": reader.orientation.describe(),
    }


def video_remarks(reader: Recording) -> list[str]:
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

    A name is the file's without its ending; with it where two files differ in that alone. Small copies that cameras
    keep beside their recordings are none of them.
    """
    if root.is_file():
        return {root.stem: root}
    if not root.is_dir():
        raise DatasetError("no such file or folder", root)
    files = [p for p in children(root) if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file()]
    files = [p for p in files if not _is_proxy(p)] or files
    found = by_stem(p for p in files if not is_second_lens(p))
    if not found:
        raise DatasetError(f"no video here ({', '.join(VIDEO_SUFFIXES)})", root)
    return found


def _is_proxy(path: Path) -> bool:
    """GoPro's GL010013.LRV beside GS010013.360, Insta360's LRV_... beside VID_...: the same in a low resolution."""
    return path.suffix.lower() == ".lrv" or path.name.upper().startswith("LRV_")


class Video(Dataset):
    """360-degree videos: ``root`` is a file, or a folder of them. `--calibration`: videos of any lens."""

    name = "video"
    takes = frozenset({"layout", "calibration"})

    def sequences(self) -> list[str]:
        if self.root is None:
            raise DatasetError("dataset 'video' needs --root FILE (or --root FOLDER --sequence NAME)")
        return list(video_files(self.root))

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name = choose_sequence(self.name, sequence, self.sequences())
        assert self.root is not None
        path = video_files(self.root)[name]
        calibration, layout = self.given.calibration, self.given.layout
        if calibration is not None:
            if layout is not None:
                raise UsageError("--layout and --calibration exclude each other: both say what took the pictures")
            lens = LensReader(VideoReader(path), calibration)
            mask = beside_video(path, (lens.video.width, lens.video.height))
            return VideoSequence(lens, name, width, self.name, mask)
        panoramas = read_panoramas(open_recording(path), layout)
        shape = (panoramas.width, panoramas.height)
        mask = mask_of_panorama(partial(beside_video, path), panoramas.layout, panoramas.stored, shape)
        return VideoSequence(panoramas, name, width, self.name, mask)

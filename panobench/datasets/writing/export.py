"""Converting a sequence to other cameras and writing the results in panobench's format.

Each source frame is decoded once and reprojected to every target; frames are written in parallel and
journalled, so that a second call continues where the first stopped.
"""

from __future__ import annotations

import os
import shutil
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.factory import CameraChoice
from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.checksums import sha256_bytes
from panobench.datasets.files.images import encode_depth, encode_image
from panobench.datasets.writing.converted import seen_from, with_valid
from panobench.datasets.writing.writer import SequenceWriter, finished_as
from panobench.errors import DatasetError
from panobench.geometry import make_pose
from panobench.types import NovelView, Trajectory

#: Goes up when the same options give other files.
CONVERSION_VERSION = 2
#: Called with the number of frames, of all targets, that were finished since the last call.
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Target:
    """One sequence to be written: its path, its camera and the camera's rotation."""

    path: Path
    choice: CameraChoice


@dataclass(frozen=True)
class ExportOptions:
    """every: frames 0, every, 2 every, ...; image_format: png or jpg; workers: threads that reproject and encode."""

    every: int = 1
    image_format: str = "png"
    workers: int = 1


class Exporter:
    """Converts ``sequence`` to ``targets``. The constructor checks everything that needs no writing.

    Raises UnsupportedError if a target sees nothing of the source, UsageError if there is something at a target's path
    that was made with other options.
    """

    def __init__(self, sequence: FrameSequence, targets: Iterable[Target], options: ExportOptions) -> None:
        self.sequence, self.options = sequence, options
        self.targets = list(targets)
        self.indices = list(range(0, len(sequence), options.every))
        self._source = {k: v for k, v in sequence.provenance().items() if k not in ("root", "meta")}
        self._fingerprints = [self._fingerprint(t) for t in self.targets]
        self.finished = [finished_as(t.path, f) for t, f in zip(self.targets, self._fingerprints)]
        # The maps of large images take seconds to compute, so only unfinished targets get them.
        self._made = {k: self._make_reprojector(k) for k, finished in enumerate(self.finished) if not finished}

    def _make_reprojector(self, k: int) -> Reprojector:
        choice = self.targets[k].choice
        return Reprojector(self.sequence.camera, choice.camera, choice.R_target_source)

    def reprojector(self, k: int) -> Reprojector:
        """Source to target ``k``."""
        if k not in self._made:
            self._made[k] = self._make_reprojector(k)
        return self._made[k]

    def camera(self, k: int) -> Camera:
        """The camera of target ``k`` with a mask of what the source saw."""
        return with_valid(self.targets[k].choice.camera, self.reprojector(k).valid)

    def estimate_bytes(self, k: int) -> int:
        """Approximate size of target ``k`` in bytes, from one encoded frame."""
        index = self.indices[len(self.indices) // 2]
        reprojector = self.reprojector(k)
        one = len(encode_image(reprojector.image(self.sequence.image(index)), "." + self.options.image_format))
        total = one * len(self.indices)
        for i in self.indices[:1]:
            depth = self.sequence.depth(i)
            if depth is not None:
                with_depth = sum(self.sequence.depth(j) is not None for j in self.indices[:20]) / len(self.indices[:20])
                total += round(len(encode_depth(reprojector.depth(depth))) * len(self.indices) * with_depth)
        return total

    def write(self, progress: Progress = lambda _: None) -> list[Path]:
        """Write every unfinished target. If it fails, the next call continues with what was written."""
        pending = [k for k, finished in enumerate(self.finished) if not finished]
        progress(len(self.indices) * (len(self.targets) - len(pending)))
        with ExitStack() as stack:
            writers = {k: stack.enter_context(closing(self._writer(k))) for k in pending}
            self._write_frames(writers, progress)
            for k, writer in writers.items():
                self._finish(k, writer)
        return [t.path for t in self.targets]

    def _writer(self, k: int) -> SequenceWriter:
        return SequenceWriter(
            self.targets[k].path,
            self.camera(k),
            image_format=self.options.image_format,
            fingerprint=self._fingerprints[k],
        )

    def _write_frames(self, writers: dict[int, SequenceWriter], progress: Progress) -> None:
        progress(sum(len(w.done) for w in writers.values()))
        todo = {i: [k for k, writer in writers.items() if i not in writer.done] for i in self.indices}
        with ThreadPoolExecutor(max_workers=self.options.workers) as pool:
            running: deque[Future[None]] = deque()
            try:
                for index in (i for i in self.indices if todo[i]):
                    # This thread decodes in order, which is the only fast way for videos and bags.
                    image, depth = self.sequence.image(index), self.sequence.depth(index)
                    for k in todo[index]:
                        running.append(pool.submit(self._write_one, writers[k], k, index, image, depth))
                    while len(running) > 2 * self.options.workers:
                        running.popleft().result()
                        progress(1)
                while running:
                    running.popleft().result()
                    progress(1)
            except BaseException:
                for future in running:
                    future.cancel()
                raise

    def _write_one(
        self,
        writer: SequenceWriter,
        k: int,
        index: int,
        image: NDArray[np.uint8],
        depth: NDArray[np.float32] | None,
    ) -> None:
        reprojector = self.reprojector(k)
        writer.add(
            index,
            float(self.sequence.times[index]),
            reprojector.image(image),
            None if depth is None else reprojector.depth(depth),
        )

    def _finish(self, k: int, writer: SequenceWriter) -> None:
        reprojector = self.reprojector(k)
        truth = self.sequence.groundtruth
        if truth is not None:
            keep = np.isin(truth.times, self.sequence.times[self.indices])
            truth = Trajectory(truth.times[keep], reprojector.poses(truth.T_wc[keep]))
        imu = None if self.sequence.imu is None else seen_from(self.sequence.imu, reprojector)
        meta: dict[str, Any] = {
            "source": self.sequence.provenance(),
            "conversion": {
                "camera": self.targets[k].choice.label,
                "target_T_source": make_pose(reprojector.R_target_source, np.zeros(3)).tolist(),
                "every": self.options.every,
            },
        }
        novel = [
            NovelView(v.name, reprojector.image(v.image), writer.camera, reprojector.poses(v.T_wc))
            for v in self.sequence.novel_views()
            if v.camera == self.sequence.camera
        ]
        writer.finish(groundtruth=truth, imu=imu, novel=novel, meta=meta)

    def _fingerprint(self, target: Target) -> dict[str, Any]:
        """What must be equal in a partial or finished sequence for it to be the one wanted."""
        mask = self.sequence.camera.mask
        return {
            "conversion": CONVERSION_VERSION,
            "source": self._source,
            "source_camera": self.sequence.camera.to_dict(),
            "source_mask": None if mask is None else sha256_bytes(mask.tobytes()),
            "camera": target.choice.camera.to_dict(),
            "rotation": np.round(target.choice.R_target_source, 12).tolist(),
            "every": self.options.every,
            "format": self.options.image_format,
        }


def free_bytes(path: Path) -> int:
    """Free space on the file system that ``path`` will be written to."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return shutil.disk_usage(path).free


def check_writable(out: Path) -> None:
    """Raise DatasetError if ``out`` cannot become a folder to write to."""
    existing = out
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise DatasetError("a file is in the way of the output folder", existing)
    if not os.access(existing, os.W_OK):
        raise DatasetError("no permission to write here", existing)

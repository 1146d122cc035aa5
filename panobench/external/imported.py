"""Imported results: a trajectory, and renders if there are any, in the place of a method's answer."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.listing import children
from panobench.errors import InputError
from panobench.methods.base import BatchMethod, MethodContext
from panobench.trajectories.matching import Frames, Placed, place
from panobench.trajectories.posed import PoseList
from panobench.trajectories.reading import read_poses
from panobench.types import Estimate

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.cameras.reproject import Reprojector

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class ImportOptions:
    """form: a format of ``trajectories.reading.FORMATS``, or None to tell from the file. inverse: it holds
    world-to-camera poses. time_unit: what its times count, "s", "ms", "us", "ns" or "frames", or None to tell.

    time_offset: seconds added to its times. max_dt: seconds between a pose and its frame at most (None: 40% of the
    smallest interval between frames). metric: its scale is metres. keyframes: it has poses of keyframes alone.
    """

    form: str | None = None
    inverse: bool = False
    time_offset: float = 0.0
    max_dt: float | None = None
    metric: bool = False
    renders: Path | None = None
    time_unit: str | None = None
    keyframes: bool = False


def read_imported(path: Path, options: ImportOptions) -> PoseList:
    """The file's poses, turned to camera-to-world. Raises InputError for a file that does not parse."""
    found = read_poses(path, options.form, options.time_unit)
    return found.inverted() if options.inverse else found


@dataclass
class ImportedTrajectory(BatchMethod):
    """Answers with the poses of a file. ``render`` gives the stored render of the frame at that pose.

    frames: what the poses are matched to, where that is not what ``run`` is given. poses: the file's, if read before.
    placed: which pose belongs to which frame, once it has run.
    """

    path: Path
    options: ImportOptions = field(default_factory=ImportOptions)
    frames: Frames | None = None
    poses: PoseList | None = None
    placed: Placed | None = None

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """Raises InputError for a trajectory or renders that cannot be used."""
        frames = self.frames or Frames.of(sequence)
        found = self.poses or read_imported(self.path, self.options)
        options = self.options
        self.placed = place(found, frames, self.path, time_offset=options.time_offset, max_dt=options.max_dt)
        trajectory, index = self.placed.trajectory, self.placed.index.tolist()
        self._camera = sequence.camera
        self._poses = trajectory.T_wc
        self._files = [] if self.options.renders is None else find_renders(self.options.renders, index, sequence)
        self._cuts: dict[bytes, Reprojector] = {}
        extra = {"file": self.path.name, "poses_in_frames": len(trajectory), "renders": len(self._files)}
        keyframes = index if options.keyframes else []
        return Estimate(trajectory, keyframes=keyframes, metric=options.metric, extra=extra)

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """The render of the frame at the position of ``T_wc``, reprojected to ``camera``; None at other positions."""
        if not self._files:
            return None
        distance = np.linalg.norm(self._poses[:, :3, 3] - T_wc[:3, 3], axis=1)
        near = np.flatnonzero(distance <= 1e-9 * (1 + np.abs(T_wc[:3, 3]).max()))
        if not len(near):
            return None
        # of frames at the same position, the one with the smallest rotation to the view
        turn = np.einsum("nij,ij->n", self._poses[near, :3, :3], T_wc[:3, :3])
        k = int(near[int(np.argmax(turn))])
        image = _read_render(self._files[k], self._camera)
        R = T_wc[:3, :3].T @ self._poses[k, :3, :3]
        if (
            camera.kind == self._camera.kind
            and camera.width == self._camera.width
            and np.allclose(R, np.eye(3), atol=1e-9)
        ):
            return image
        return self._cut(camera, R, image)

    def _cut(self, camera: Camera, R: NDArray[np.float64], image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Reproject a render as the reference views are cut out of the frames, so that both are blurred alike."""
        from panobench.cameras.reproject import Reprojector
        from panobench.metrics.perspective import enlarge

        key = np.round(R, 6).tobytes() + f"{camera.to_dict()}".encode()
        panorama = self._camera.kind == "erp" and bool(self._camera.valid_mask().all())
        if key not in self._cuts:
            source = self._camera.scaled(2 * self._camera.width) if panorama else self._camera
            self._cuts[key] = Reprojector(source, camera, R, antialias=not panorama)
        source_image = enlarge(image) if panorama else image
        return np.asarray(np.clip(self._cuts[key].image(source_image), 0, 1), dtype=np.float32)


def find_renders(folder: Path, index: list[int], sequence: FrameSequence) -> list[Path]:
    """The render of each frame in ``index``: named as the frame, by its number, or as many as there are in order.

    Raises InputError naming the first frame that has none.
    """
    if not folder.is_dir():
        raise InputError("no such folder of renders", folder)
    files = [p for p in children(folder) if p.suffix.lower() in IMAGE_SUFFIXES]
    by_stem = {p.stem: p for p in files}
    if len(by_stem) < len(files):
        twice = next(p for p in files if by_stem[p.stem] is not p)
        raise InputError(f"two renders of one name: {twice.name} and {by_stem[twice.stem].name}; keep one", folder)
    by_number = _by_number(files, len(sequence))
    names = {i: Path(sequence.frame_name(i)).stem for i in index}
    for table in ({i: by_stem.get(names[i]) for i in index}, {i: by_number.get(i) for i in index}):
        if all(table.values()):
            return [path for path in table.values() if path is not None]
    if len(files) in (len(index), len(sequence)):
        return files if len(files) == len(index) else [files[i] for i in index]
    missing = next(i for i in index if by_stem.get(names[i]) is None and by_number.get(i) is None)
    raise InputError(f"no render for frame {missing} ('{names[missing]}'): {len(files)} images, none named so", folder)


def _by_number(files: list[Path], frames: int) -> dict[int, Path]:
    """Files by the number at the end of their names, where those differ in nothing else: render_7. Counted from 0, or
    from 1 where there are exactly as many as ``frames``.
    """
    split = {p: re.fullmatch(r"(.*?)([0-9]+)", p.stem) for p in files}
    heads = {m[1] if m else None for m in split.values()}
    if len(heads) != 1 or None in heads:
        return {}
    found = {int(m[2]): p for p, m in split.items() if m}
    if set(found) == set(range(1, frames + 1)):
        return {number - 1: path for number, path in found.items()}
    return found


def _read_render(path: Path, camera: Camera) -> NDArray[np.float32]:
    """RGB (H, W, 3) in 0..1. Raises InputError if it is no image of the camera's size."""
    from panobench.datasets.files.images import read_image

    image = read_image(path)
    if image.shape != (camera.height, camera.width, 3):
        raise InputError(
            f"the render is {image.shape[1]}x{image.shape[0]}, the frames are {camera.width}x{camera.height}; "
            "render at that size or give another --width",
            path,
        )
    return np.asarray(image / np.float32(255), dtype=np.float32)

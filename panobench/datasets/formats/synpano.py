"""SynPano: synthetic panoramas with ground truth in raw Blender camera axes.

Layout of a scene: ``images/*.{png,jpg}``, ``groundtruth.txt`` with rows
``frame_id image_name x y z qx qy qz qw`` (some releases start with a header line), optional
``depth/<stem>.{npy,png}`` and, for evaluating maps, ``novel/`` with ``novel_groundtruth.txt``.
Blender's camera looks along -z with y up: R_cv = R_blender diag(1, -1, -1). Time = frame_id / 15 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.files.columns import columns
from panobench.datasets.files.images import list_images, read_image
from panobench.datasets.files.listing import children, one_of_each
from panobench.datasets.files.trajectory_io import check_times, parse_floats, poses_from_rows, read_rows
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.locate import choose_sequence
from panobench.errors import DatasetError
from panobench.types import NovelView, Trajectory

#: Blender camera axes (x right, y up, z backward) to the package's (x right, y down, z forward).
CV_FROM_BLENDER = np.diag([1.0, -1.0, -1.0])
RATE_HZ = 15.0
_COLUMNS = "frame_id image_name x y z qx qy qz qw"


@dataclass(frozen=True)
class PoseTable:
    """Rows of a groundtruth.txt: ids (N,), image names, raw poses (N, 4, 4) and line numbers."""

    ids: NDArray[np.float64]
    names: list[str]
    T_wc: NDArray[np.float64]
    lines: list[int]


def read_pose_table(path: Path) -> PoseTable:
    """Parse ``frame_id image_name x y z qx qy qz qw`` rows; poses as stored. Raises DatasetError with file:line."""
    rows = read_rows(path)
    order = [2, 3, 4, 5, 6, 7, 8]
    if rows and _is_header(rows[0].fields):
        named = columns(rows[0].fields)
        if named.position is not None and named.quaternion is not None and len(rows[0].fields) == 9:
            order = [*named.position, *named.quaternion]
        rows = rows[1:]
    if not rows:
        raise DatasetError("the file has no pose", path)
    ids, names, numbers = [], [], []
    for row in rows:
        if len(row.fields) != 9:
            raise DatasetError(f"the row has {len(row.fields)} values, expected 9: {_COLUMNS}", path, line=row.line)
        if "/" in row.fields[1] or "\\" in row.fields[1]:
            raise DatasetError(f"'{row.fields[1]}' is not a plain file name", path, line=row.line)
        ids += parse_floats(row, row.fields[:1], path, _COLUMNS)
        names.append(row.fields[1])
        numbers.append(parse_floats(row, [row.fields[k] for k in order], path, _COLUMNS))
    lines = [row.line for row in rows]
    values = np.array(numbers)
    return PoseTable(np.array(ids), names, poses_from_rows(values, path, lines), lines)


def _is_header(fields: list[str]) -> bool:
    """Whether it is a header line, which has words in place of a pose's numbers."""
    for text in fields[2:]:
        try:
            float(text)
        except ValueError:
            continue
        return False
    return len(fields) > 2


def raw_to_camera_axes(T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (..., 4, 4) with Blender's camera axes changed to x right, y down, z forward."""
    out = T_wc.copy()
    out[..., :3, :3] = T_wc[..., :3, :3] @ CV_FROM_BLENDER
    return out


def panorama_camera(size: tuple[int, int], path: Path) -> Camera:
    """The full-sphere ERP camera of 2:1 images. Raises DatasetError for other proportions."""
    width, height = size
    if width != 2 * height:
        raise DatasetError(
            f"the image is {width}x{height} pixels; a full equirectangular panorama is twice as wide as high "
            "(--dataset images and video read others, see --layout)",
            path,
        )
    return ErpCamera.from_dict({"model": "erp", "width": width, "height": height})


def named_images(folder: Path, table: PoseTable, table_path: Path) -> list[Path]:
    """The image file of every row. Raises DatasetError, with the row's line, if one is missing."""
    present = {path.name: path for path in list_images(folder)}
    found = []
    for name, line in zip(table.names, table.lines):
        if name not in present:
            raise DatasetError(f"image '{name}' is missing in {folder}", table_path, line=line)
        found.append(present[name])
    return found


def depth_files(folder: Path, images: list[Path]) -> dict[int, Path]:
    """The depth files, ``folder/<stem>.npy`` or ``.png``, by frame index."""
    if not folder.is_dir():
        return {}
    present = {p.name: p for p in folder.iterdir() if p.suffix.lower() in (".npy", ".png")}
    found = {}
    for index, image in enumerate(images):
        for suffix in (".npy", ".png"):
            if image.stem + suffix in present:
                found[index] = present[image.stem + suffix]
                break
    return found


def is_scene(folder: Path) -> bool:
    return (folder / "images").is_dir()


def scene_names(root: Path, dataset: str) -> list[str]:
    """The scenes at ``root``: itself, or its sub-folders. Raises DatasetError if there is none."""
    if not root.is_dir():
        raise DatasetError(f"{dataset} is a folder of scenes, this is a file", root)
    if is_scene(root):
        return [root.resolve().name]
    names = [p.name for p in children(root) if p.is_dir() and is_scene(p)]
    if not names:
        raise DatasetError(
            f"no {dataset} scene here: neither images/ nor a sub-folder that has images/; a folder of images is read "
            "without --dataset, or with --dataset images",
            root,
        )
    return names


class SynPano(Dataset):
    """Scenes in SynPano's layout below ``root``; or ``root`` is one."""

    name = "synpano"
    rate_hz = RATE_HZ

    def sequences(self) -> list[str]:
        if self.root is None:
            raise DatasetError(f"dataset '{self.name}' needs --root PATH")
        return scene_names(self.root, self.name)

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        name = choose_sequence(self.name, sequence, self.sequences())
        assert self.root is not None
        folder = self.root if is_scene(self.root) else self.root / name
        return ImageSequence(self._read(folder, name), width)

    def axes(self, T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
        """Camera-to-world poses in the package's camera axes of stored poses (N, 4, 4)."""
        return raw_to_camera_axes(T_wc)

    def _read(self, folder: Path, name: str) -> ImageSource:
        table_path = folder / "groundtruth.txt"
        every_image = list_images(folder / "images")
        groundtruth = None
        if table_path.is_file():
            table = read_pose_table(table_path)
            images = named_images(folder / "images", table, table_path)
            times = table.ids / self.rate_hz
            check_times(times, table_path, table.lines)
            groundtruth = Trajectory(times, self.axes(table.T_wc))
        else:
            images = one_of_each(every_image)
            times = np.arange(len(images)) / self.rate_hz
        if not images:
            raise DatasetError("the sequence is empty: images/ has no image", folder)
        native = panorama_camera(check_sizes(images[:1]), images[0])
        return ImageSource(
            dataset=self.name,
            name=name,
            root=folder,
            native=native,
            times=times,
            images=images,
            groundtruth=groundtruth,
            depth=depth_files(folder / "depth", images),
            inputs=(table_path,) if groundtruth is not None else (),
            notes={"rate_hz": self.rate_hz, "images_without_pose": len(every_image) - len(images)},
            novel=lambda: self._novel(folder, native),
        )

    def _novel(self, folder: Path, camera: Camera) -> list[NovelView]:
        table_path = folder / "novel_groundtruth.txt"
        if not table_path.is_file():
            return []
        table = read_pose_table(table_path)
        images = named_images(folder / "novel", table, table_path)
        check_sizes(images, (camera.width, camera.height))
        poses = self.axes(table.T_wc)
        return [NovelView(p.stem, read_image(p), camera, T) for p, T in zip(images, poses)]

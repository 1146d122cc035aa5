"""panobench's own sequence format: what `panobench convert` writes and anyone can write by hand.

``camera.yaml``, ``images/``, ``frames.csv`` with columns time,file (seconds; path inside the sequence),
optional ``groundtruth.tum`` (camera-to-world), ``imu.csv`` (time,wx,wy,wz,ax,ay,az),
``depth/<stem>.npy|png`` (radial), ``mask.png`` (white = valid), ``novel.csv`` (file,x,y,z,qx,qy,qz,qw: views of the
same camera apart from the trajectory), ``meta.json``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from panobench.cameras.base import Camera
from panobench.cameras.calibration import Calibration, inspect_calibration
from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.files.images import read_image
from panobench.datasets.files.imu_table import read_imu_table
from panobench.datasets.files.listing import children
from panobench.datasets.files.trajectory_io import (
    check_times,
    parse_floats,
    poses_from_rows,
    read_named_rows,
    read_rows,
    read_tum,
)
from panobench.datasets.files.truth import truth_at_frames
from panobench.datasets.formats.image_sequence import ImageSequence, ImageSource, check_sizes
from panobench.datasets.locate import choose_sequence
from panobench.errors import DatasetError
from panobench.masks.files import mask_of_folder
from panobench.reading import inside, number_array, parse_json, read_text
from panobench.types import Imu, NovelView

#: meta.json lists a checksum for every file.
MAX_META_BYTES = 256 << 20


def read_imu_csv(path: Path) -> Imu:
    """imu.csv: time,wx,wy,wz,ax,ay,az in s, rad/s and m/s^2, or in the order and unit of time that its header names.

    Raises DatasetError with file:line.
    """
    return read_imu_table(path, exact=True)


def is_sequence(folder: Path) -> bool:
    return (folder / "frames.csv").is_file() or (folder / "camera.yaml").is_file()


def find_sequences(root: Path, levels: int = 3) -> list[str]:
    """Sequences below ``root`` as relative paths, at most ``levels`` folders down; unfinished ones are skipped."""
    found = []
    for child in (p for p in children(root) if p.is_dir()):
        if child.name.endswith(".partial"):
            continue
        if is_sequence(child):
            found.append(child.name)
        elif levels > 1:
            found += [f"{child.name}/{name}" for name in find_sequences(child, levels - 1)]
    return found


class Folder(Dataset):
    """Sequences in panobench's format below ``root``; or ``root`` is one."""

    name = "folder"

    def _at(self) -> Path:
        if self.root is None:
            raise DatasetError("dataset 'folder' needs --root PATH")
        if self.root.name.endswith(".partial"):
            raise DatasetError("this is an unfinished conversion; run the same `panobench convert` again", self.root)
        return self.root

    def sequences(self) -> list[str]:
        root = self._at()
        if not root.is_dir():
            raise DatasetError("a panobench sequence is a folder, this is a file", root)
        if is_sequence(root):
            return [root.resolve().name]
        names = find_sequences(root)
        if not names:
            raise DatasetError(
                "no panobench sequence here: frames.csv, camera.yaml and images/ are expected; a folder of images is "
                "read without --dataset, or with --dataset images",
                root,
            )
        return names

    def open(self, sequence: str | None = None, *, width: int | None = None) -> FrameSequence:
        root = self._at()
        name = choose_sequence(self.name, sequence, self.sequences())
        return ImageSequence(_read(root if is_sequence(root) else root / name, name), width)


def _read(folder: Path, name: str) -> ImageSource:
    calibration = inspect_calibration(folder / "camera.yaml")
    camera = calibration.camera
    frames_path = folder / "frames.csv"
    times, images = _read_frames(frames_path, folder)
    inputs = [folder / "camera.yaml", frames_path]
    truth_path, imu_path = folder / "groundtruth.tum", folder / "imu.csv"
    mask = mask_of_folder([folder], (camera.width, camera.height))
    camera = mask.on(camera)
    present = {p.name: p for p in (folder / "depth").iterdir()} if (folder / "depth").is_dir() else {}
    depth_files = {}
    for index, image in enumerate(images):
        file = present.get(image.stem + ".npy") or present.get(image.stem + ".png")
        if file is not None:
            depth_files[index] = file
    meta = _read_meta(folder / "meta.json")
    recorded = read_tum(truth_path) if truth_path.is_file() else None
    return ImageSource(
        dataset="folder",
        name=name,
        root=folder,
        native=camera,
        times=times,
        images=images,
        groundtruth=None if recorded is None else truth_at_frames(recorded, times),
        recorded_truth=recorded,
        imu=_read_imu(imu_path, calibration, meta) if imu_path.is_file() else None,
        depth=depth_files,
        inputs=(*inputs, *mask.files(), *(p for p in (truth_path, imu_path) if p.is_file())),
        notes={**({"meta": meta} if meta else {}), **mask.about()},
        remarks=mask.remarks,
        novel=lambda: _read_novel(folder, camera),
    )


def _read_imu(path: Path, calibration: Calibration, meta: dict[str, Any]) -> Imu:
    """imu.csv on the camera's clock. meta.json, or else camera.yaml, has the camera's pose on the body."""
    imu = read_imu_csv(path)
    pose = _pose_note(meta, path.with_name("meta.json"))
    return replace(
        imu,
        times=imu.times - (calibration.time_offset_s or 0.0),
        T_body_cam=calibration.body_T_cam if pose is None else pose,
    )


def _read_frames(path: Path, folder: Path) -> tuple[np.ndarray, list[Path]]:
    """Times (N,) and image paths of frames.csv."""
    rows = read_rows(path, delimiter=",")
    if rows and rows[0].fields[:2] == ["time", "file"]:
        rows = rows[1:]
    if not rows:
        raise DatasetError("the sequence is empty: the file has no row", path)
    times, images = [], []
    for row in rows:
        if len(row.fields) != 2:
            raise DatasetError(f"the row has {len(row.fields)} values, expected 2: time,file", path, line=row.line)
        times += parse_floats(row, row.fields[:1], path, "time,file")
        images.append(_image_inside(folder, row.fields[1], path, row.line))
    stamps = np.array(times)
    check_times(stamps, path, [row.line for row in rows])
    return stamps, images


def _image_inside(folder: Path, name: str, path: Path, line: int) -> Path:
    """The image that a row names; it must be inside the sequence's folder."""
    file = inside(folder, name)
    if file is None:
        raise DatasetError(f"'{name[:200]}' does not lie inside the sequence", path, line=line)
    try:
        found = file.is_file()
    except OSError:  # a part of the path is longer than any file name
        found = False
    if not found:
        raise DatasetError(f"image '{name}' is missing", path, line=line)
    return file


def _read_novel(folder: Path, camera: Camera) -> list[NovelView]:
    """The views of novel.csv, which the sequence's camera took; empty without that file."""
    path = folder / "novel.csv"
    if not path.is_file():
        return []
    expected = "file,x,y,z,qx,qy,qz,qw"
    table = read_named_rows(path)
    place, turn = table.columns.position or (1, 2, 3), table.columns.quaternion or (4, 5, 6, 7)
    images, numbers = [], []
    for row in table.rows:
        if len(row.fields) != max(7, *place, *turn) + 1:
            raise DatasetError(f"the row has {len(row.fields)} values, expected 8: {expected}", path, line=row.line)
        images.append(_image_inside(folder, row.fields[0], path, row.line))
        numbers.append(parse_floats(row, [row.fields[k] for k in (*place, *turn)], path, expected))
    values = np.array(numbers).reshape(-1, 7)
    poses = poses_from_rows(values, path, [row.line for row in table.rows])
    check_sizes(images, (camera.width, camera.height))
    return [NovelView(p.stem, read_image(p), camera, T) for p, T in zip(images, poses)]


def _read_meta(path: Path) -> dict[str, Any]:
    """What meta.json says about the sequence's origin, without the checksums; {} without that file."""
    if not path.is_file():
        return {}
    meta = parse_json(read_text(path, "the file", MAX_META_BYTES, DatasetError), path, DatasetError)
    if not isinstance(meta, dict):
        raise DatasetError("expected a JSON object", path)
    return {k: v for k, v in meta.items() if k != "checksums"}


def _pose_note(meta: dict[str, Any], path: Path) -> np.ndarray | None:
    """meta.json's "body_T_cam", a rigid 4x4 matrix, if it has one."""
    if meta.get("body_T_cam") is None:
        return None
    T = number_array(meta["body_T_cam"])
    if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3):
        raise DatasetError("'body_T_cam' is not a rigid 4x4 matrix", path)
    return T

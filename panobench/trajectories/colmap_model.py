"""COLMAP's images.txt and images.bin: world-to-camera poses by image name.

A text file has two lines an image, `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME` and its points (which may be empty,
and is left out by some programs). images.bin, little-endian: the number of images (uint64), then of each its id
(uint32), qw qx qy qz tx ty tz (float64), the camera's id (uint32), its name up to a zero, the number of its points
(uint64) and 24 bytes for each. https://colmap.github.io/format.html
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from panobench.datasets.files.trajectory_io import MAX_TEXT_BYTES, is_number, poses_from_rows
from panobench.errors import DatasetError
from panobench.geometry import invert_pose
from panobench.reading import read_text
from panobench.trajectories.posed import Array, PoseList

#: A name in images.bin is no longer.
_MAX_NAME = 4096
_FIXED = struct.Struct("<I7dI")


class ColmapImages(NamedTuple):
    """T_wc (N, 4, 4), names and camera ids of the registered images, in the order of the file."""

    T_wc: Array
    names: tuple[str, ...]
    cameras: tuple[int, ...]


def is_image_line(fields: list[str]) -> bool:
    """A line that names an image; one of points, or of a matrix, is made of numbers alone."""
    if len(fields) < 10 or not all(text.isascii() and text.isdigit() and len(text) < 12 for text in fields[:9:8]):
        return False
    return len(fields) == 10 or not all(is_number(text) for text in fields)


def read_images(path: Path) -> ColmapImages:
    """Either file. Raises DatasetError naming the line, or the image's number in a binary file."""
    try:
        with path.open("rb") as file:
            if b"\0" in file.read(4096):
                file.seek(0)
                return _binary(file, path)
    except OSError as error:
        raise DatasetError(f"the file cannot be read ({error.strerror})", path) from None
    return _text(path)


def read_poses(path: Path) -> PoseList:
    """Poses by image name; COLMAP's unit of length is arbitrary."""
    found = read_images(path)
    return PoseList(found.T_wc, "colmap", names=found.names, scaled=False)


def _text(path: Path) -> ColmapImages:
    text = read_text(path, "the file", MAX_TEXT_BYTES, DatasetError)
    rows: list[tuple[float, ...]] = []
    names: list[str] = []
    cameras: list[int] = []
    lines: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#") or not is_image_line(fields):
            continue
        try:
            w, x, y, z, tx, ty, tz = (float(text) for text in fields[1:8])
        except ValueError:
            raise DatasetError(
                "expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, found a word", path, line=number
            ) from None
        rows.append((tx, ty, tz, x, y, z, w))
        names.append(line.split(maxsplit=9)[9].strip())
        cameras.append(int(fields[8]))
        lines.append(number)
    return _poses(rows, names, cameras, lines, path)


def _binary(file: BinaryIO, path: Path) -> ColmapImages:
    rows: list[tuple[float, ...]] = []
    names: list[str] = []
    cameras: list[int] = []
    size = path.stat().st_size
    try:
        (count,) = struct.unpack("<Q", file.read(8))
        if count > size // (_FIXED.size + 9):
            raise DatasetError(
                f"it claims {count} images, more than fit into the file; is it COLMAP's images.bin?", path
            )
        for _ in range(count):
            _, w, x, y, z, tx, ty, tz, camera = _FIXED.unpack(file.read(_FIXED.size))
            rows.append((tx, ty, tz, x, y, z, w))
            cameras.append(camera)
            names.append(_name(file, path, len(names)))
            (points,) = struct.unpack("<Q", file.read(8))
            if 24 * points > size:
                raise struct.error
            file.seek(24 * points, 1)
    except struct.error:
        raise DatasetError("the file is cut short, or is no images.bin of COLMAP", path, frame=len(names)) from None
    if file.tell() > size:
        raise DatasetError("the file is cut short", path, frame=len(names) - 1)
    return _poses(rows, names, cameras, [], path)


def _name(file: BinaryIO, path: Path, number: int) -> str:
    start = file.tell()
    data = file.read(_MAX_NAME)
    end = data.find(b"\0")
    if end < 0:
        raise DatasetError("an image has no name; is it COLMAP's images.bin?", path, frame=number)
    file.seek(start + end + 1)
    return data[:end].decode("utf-8", "surrogateescape")


def _poses(
    rows: list[tuple[float, ...]], names: list[str], cameras: list[int], lines: list[int], path: Path
) -> ColmapImages:
    if not rows:
        raise DatasetError("the model has no registered image", path)
    table = np.array(rows, dtype=np.float64)
    if not np.isfinite(table).all():
        bad = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise DatasetError(
            "a pose is not finite", path, line=lines[bad] if lines else None, frame=None if lines else bad
        )
    T_cw = poses_from_rows(table, path, lines or list(range(len(rows))))
    return ColmapImages(invert_pose(T_cw), tuple(names), tuple(cameras))

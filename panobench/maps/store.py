"""The folder of a saved map: ``map.json`` names everything else, by content.

Files are named by the SHA-256 of what they hold and never changed. A new state of the map writes those that are not
there yet, then replaces ``map.json`` as a whole, then removes what it no longer names: whenever the writer stops, the
folder holds the old state or the new one. Nothing that is read runs code.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.factory import camera_from_dict
from panobench.errors import InputError, OutputError
from panobench.maps.saved import SavedKeyframe, SavedMap
from panobench.reading import parse_json, read_bytes, read_text
from panobench.splat.gaussians import GaussianMap
from panobench.splat.ply import read_ply
from panobench.writing import write_whole, writing

INDEX = "map.json"
#: What ``map.json`` says it is; ``VERSION`` is raised when older readers would misread a folder.
FORMAT, VERSION = "panobench map", 1
#: Bounds for a reader: bytes of the index, of a keyframe's file, of the Gaussians' file; keyframes; a side in pixels.
INDEX_BYTES, IMAGE_BYTES, GAUSSIAN_BYTES = 64 << 20, 256 << 20, 8 << 30
KEYFRAMES_MOST, SIDE_MOST = 100_000, 16_384
#: How far R^T R may be from the identity.
_RIGID = 1e-6
_NAME = re.compile(r"[0-9a-f]{64}\.(ply|png|npy)")


class MapError(InputError):
    """A saved map that cannot be read."""


# -- writing ---------------------------------------------------------------------------------------------------------


def check_writable(folder: Path) -> None:
    """Raises OutputError for a folder that holds something that is no saved map."""
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir()) and not (folder / INDEX).is_file()):
        raise OutputError(f"{folder} is there and is no saved map; name another folder")


def write_map(folder: Path, saved: SavedMap) -> None:
    """Make ``folder`` hold this map, in place of the one it may hold. Raises OutputError."""
    check_writable(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    camera: dict[str, Any] = saved.camera.to_dict()
    mask = None if saved.camera.mask is None else _put(folder, _png(saved.camera.mask.astype(np.uint8) * 255), "png")
    index = {
        "format": FORMAT,
        "version": VERSION,
        "made_by": saved.made_by,
        "metric": saved.metric,
        "scene_depth": saved.scene_depth,
        "camera": camera,
        "mask": mask,
        "gaussians": _put_gaussians(folder, saved.gaussians),
        "anchors": _put(folder, saved.anchors.astype("<i4").tobytes(), "npy"),
        "keyframes": [
            {
                "index": k.index,
                "time": k.time,
                "T_wc": k.T_wc[:3].ravel().tolist(),
                "image": _put(folder, _png(cv2.cvtColor(k.image, cv2.COLOR_RGB2BGR)), "png"),
            }
            for k in saved.keyframes
        ],
    }
    write_whole(folder / INDEX, json.dumps(index, indent=1))
    _sweep(folder, index)


def _put(folder: Path, data: bytes, suffix: str) -> str:
    """Write ``data`` under its content's name unless it is there; returns the name."""
    name = f"{hashlib.sha256(data).hexdigest()}.{suffix}"
    path = folder / name
    if not (path.is_file() and path.stat().st_size == len(data)):
        write_whole(path, data)
    return name


def _put_gaussians(folder: Path, gaussians: GaussianMap) -> str:
    part = folder / ".gaussians.ply"
    with writing(folder):
        gaussians.write_ply(part)
        data = part.read_bytes()
        part.unlink()
    return _put(folder, data, "ply")


def _png(image: NDArray[Any]) -> bytes:
    done, data = cv2.imencode(".png", image)
    if not done:
        raise OutputError("an image of a map could not be encoded")
    return data.tobytes()


def _sweep(folder: Path, index: Mapping[str, Any]) -> None:
    """Remove files of earlier states. One that cannot be removed does no harm."""
    named = {index["mask"], index["gaussians"], index["anchors"], *(k["image"] for k in index["keyframes"])}
    for path in folder.iterdir():
        if _NAME.fullmatch(path.name) and path.name not in named:
            try:
                path.unlink()
            except OSError:
                continue


# -- reading ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Index:
    """``map.json``, checked."""

    folder: Path
    values: dict[str, Any]

    def value(self, name: str, kind: type | tuple[type, ...], where: Mapping[str, Any] | None = None) -> Any:
        found = (self.values if where is None else where).get(name)
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise MapError(f"'{name}' is missing or of another kind", self.folder / INDEX)
        if isinstance(found, float) and not math.isfinite(found):
            raise MapError(f"'{name}' is not finite", self.folder / INDEX)
        return found

    def file(self, name: str, limit: int) -> tuple[Path, bytes]:
        """A file that the index names, and its content, which must be what its name says."""
        if not _NAME.fullmatch(name):
            raise MapError(f"'{name[:80]}' is no file of a map", self.folder / INDEX)
        path = self.folder / name
        data = read_bytes(path, "a file of the map", limit, MapError)
        if hashlib.sha256(data).hexdigest() != path.stem:
            raise MapError("damaged: its content is not what its name says", path)
        return path, data


def read_map(folder: Path) -> SavedMap:
    """The map in ``folder``. Raises MapError for what is missing, damaged, too large or of a newer version."""
    if not folder.is_dir():
        raise MapError("no such folder; `panobench run --save-map DIR` makes one", folder)
    values = parse_json(
        read_text(folder / INDEX, "a saved map's index", INDEX_BYTES, MapError), folder / INDEX, MapError
    )
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise MapError("not the index of a saved map", folder / INDEX)
    index = _Index(folder, values)
    version = index.value("version", int)
    if version > VERSION:
        raise MapError(f"version {version} is newer than this panobench reads ({VERSION}); update it", folder / INDEX)
    camera = _camera(index)
    path, data = index.file(index.value("gaussians", str), GAUSSIAN_BYTES)
    gaussians = GaussianMap(*read_ply(path))
    del data
    anchors = np.frombuffer(index.file(index.value("anchors", str), GAUSSIAN_BYTES)[1], "<i4").astype(np.int32)
    listed = index.value("keyframes", list)
    if not 0 < len(listed) <= KEYFRAMES_MOST:
        raise MapError(f"{len(listed)} keyframes; between 1 and {KEYFRAMES_MOST} are read", folder / INDEX)
    if len(anchors) != len(gaussians) or (len(anchors) and not 0 <= anchors.min() <= anchors.max() < len(listed)):
        raise MapError("its Gaussians and keyframes do not belong together", folder / INDEX)
    depth = float(index.value("scene_depth", (int, float)))
    if not depth > 0:
        raise MapError("'scene_depth' must be positive", folder / INDEX)
    keyframes = tuple(_keyframe(index, k, camera) for k in listed)
    return SavedMap(
        gaussians, anchors, camera, keyframes, depth, index.value("metric", bool), str(index.value("made_by", str))
    )


def _camera(index: _Index) -> Camera:
    camera = camera_from_dict(index.value("camera", dict))
    if max(camera.width, camera.height) > SIDE_MOST:
        raise MapError(f"a camera of {camera.width}x{camera.height} pixels is too large", index.folder / INDEX)
    if index.values.get("mask") is None:
        return camera
    mask = _image(index, index.value("mask", str), camera, cv2.IMREAD_GRAYSCALE)
    return camera.with_mask(mask > 127)


def _keyframe(index: _Index, values: Any, camera: Camera) -> SavedKeyframe:
    if not isinstance(values, dict):
        raise MapError("a keyframe is of another kind", index.folder / INDEX)
    rows = index.value("T_wc", list, values)
    if len(rows) != 12 or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in rows):
        raise MapError("a keyframe's pose is not 3x4 finite numbers", index.folder / INDEX)
    T_wc = np.vstack([np.array(rows, np.float64).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    R = T_wc[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > _RIGID or np.linalg.det(R) < 0:
        raise MapError("a keyframe's pose is no rotation and translation", index.folder / INDEX)
    image = _image(index, index.value("image", str, values), camera, cv2.IMREAD_COLOR)
    time = float(index.value("time", (int, float), values))
    return SavedKeyframe(index.value("index", int, values), time, T_wc, cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def _image(index: _Index, name: str, camera: Camera, mode: int) -> Any:
    """A PNG of the camera's size. Its header is looked at before its pixels are decoded."""
    path, data = index.file(name, IMAGE_BYTES)
    size = (int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big"))
    if not data.startswith(b"\x89PNG\r\n\x1a\n") or size != (camera.width, camera.height):
        raise MapError(f"not a PNG of {camera.width}x{camera.height} pixels", path)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    if image is None:
        raise MapError("the image cannot be decoded", path)
    return image

"""panobench's own camera.yaml: what ``Camera.to_dict`` says, and optionally the mask.

`mask: FILE` names an image beside the file (non-zero means valid); `annulus: {centre: [u, v], r_min, r_max}` is a ring
in pixels (first pixel's centre at 0.5). `source`, `body_T_cam` (4x4) and `time_offset_s` are optional remarks.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.annulus import annulus_mask, require_agreement
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import Table, parse_yaml, read_text, write_text
from panobench.cameras.factory import camera_from_dict
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError, DatasetError
from panobench.geometry import renormalise
from panobench.reading import inside, number_array

NAME = "panobench"
_BLOCK_KEY = re.compile(r"""^(["']?)model\1\s*:""", re.MULTILINE)
_MATRIX_KEY = re.compile(r"""^\s*(["']?)camera_?matrix\1\s*:""", re.MULTILINE | re.IGNORECASE)
_EXTRA = ("mask", "annulus", "source", "body_T_cam", "time_offset_s")


def recognise(path: Path, text: str) -> bool:
    """A key `model` at the top, and no camera matrix, which would be OpenCV's. A flow mapping is parsed to tell;
    CalibrationError says where it is not YAML.
    """
    if _MATRIX_KEY.search(text):
        return False
    if _BLOCK_KEY.search(text):
        return True
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and line != "---" and line[0] not in "#%"), "")
    return first.startswith("{") and "model" in parse_yaml(text, path)


def read(path: Path, options: ReadOptions) -> Calibration:
    """Raises CalibrationError naming the file and, where it can, the line."""
    table = parse_yaml(read_text(path), path)
    values = {k: v for k, v in table.plain().items() if k not in _EXTRA}
    try:
        camera = camera_from_dict(values)
    except CalibrationError as error:
        if error.path:
            raise
        culprit = next((k for k in table if f"'{k}'" in str(error) or f"{k} must" in str(error)), None)
        raise table.error(str(error), culprit) from None
    notes: list[str] = []
    ring, annulus = None, options.annulus
    if "annulus" in table:
        ring, annulus = _ring(table.table("annulus"), camera, annulus)
    if isinstance(camera, ScaramuzzaCamera):
        notes = require_agreement(camera, path, table.lines.get("inv_poly"), annulus)
    mask = _read_mask(table, path, camera) if "mask" in table else None
    if ring is not None:
        mask = ring if mask is None else ring & mask
    offset = table.number("time_offset_s") if "time_offset_s" in table else None
    return Calibration(camera.with_mask(mask), NAME, notes, _pose(table), offset)


def _ring(
    table: Table, camera: Camera, annulus: tuple[float, float] | None
) -> tuple[NDArray[np.bool_], tuple[float, float] | None]:
    """The ring as a mask, and its radii about the model's centre."""
    u, v = table.numbers("centre", 2)
    low, high = table.number("r_min"), table.number("r_max")
    if not 0 <= low < high:
        raise table.error(f"0 <= r_min < r_max expected, not {low:g} and {high:g}", "r_min")
    if annulus is None and isinstance(camera, ScaramuzzaCamera):
        aside = float(np.hypot(u - camera.cx, v - camera.cy))
        annulus = max(low - aside, 0.0), high + aside
    return annulus_mask(camera.width, camera.height, (u, v), low, high), annulus


def _read_mask(table: Table, path: Path, camera: Camera) -> NDArray[np.bool_]:
    from panobench.datasets.files.images import decode_stored  # reads no more than its limits allow
    from panobench.masks.pixels import understand

    name = table["mask"]
    file = inside(path.parent, name) if isinstance(name, str) else None
    if file is None:
        raise table.error("'mask' must name a file beside the calibration", "mask")
    try:
        data = file.read_bytes() if file.stat().st_size <= 1 << 26 else b""
    except OSError:
        raise table.error(f"the mask file {name} is missing", "mask") from None
    try:
        valid = understand(decode_stored(data, file)).valid
    except (DatasetError, ValueError):
        raise table.error(f"the mask file {name} is not an image that can be a mask", "mask") from None
    if valid.shape != (camera.height, camera.width):
        raise table.error(
            f"the mask {name} is {valid.shape[1]}x{valid.shape[0]}, the camera {camera.width}x{camera.height}", "mask"
        )
    return valid


def _pose(table: Table) -> Array | None:
    if "body_T_cam" not in table:
        return None
    T = number_array(table["body_T_cam"])
    if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-2):
        raise table.error("'body_T_cam' is not a rigid 4x4 matrix", "body_T_cam")
    return renormalise(T)


def write(camera: Camera, path: Path) -> None:
    """camera.yaml, and its mask as an image beside it (mask.png for camera.yaml, else NAME_mask.png)."""
    import cv2
    import yaml

    values: dict[str, Any] = dict(camera.to_dict())
    if camera.mask is not None:
        name = "mask.png" if path.stem == "camera" else f"{path.stem}_mask.png"
        ok, data = cv2.imencode(".png", camera.mask.astype(np.uint8) * 255)
        if not ok:
            raise CalibrationError("the mask cannot be encoded", path)
        try:
            path.with_name(name).write_bytes(data.tobytes())
        except OSError as error:
            raise CalibrationError(f"cannot be written ({error.strerror})", path.with_name(name)) from error
        values["mask"] = name
    write_text(path, str(yaml.safe_dump(values, sort_keys=False)))

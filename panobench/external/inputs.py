"""Writing what other people's programs read: images, time lists and calibration files.

OpenCV and the programs built on it put the centre of the first pixel at (0, 0), panobench at (0.5, 0.5): principal
points written here are half a pixel smaller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.datasets.images import write_image
from panobench.errors import UnsupportedError

if TYPE_CHECKING:
    from panobench.cameras.base import Camera


@dataclass(frozen=True)
class WrittenImages:
    """The folder and the images' names in it, one per frame."""

    folder: Path
    names: list[str]


def write_images(
    sequence: FrameSequence,
    folder: Path,
    *,
    grey: bool = False,
    names: list[str] | None = None,
    keep: NDArray[np.bool_] | None = None,
) -> WrittenImages:
    """PNG files in frame order, named 000000.png ... unless ``names`` are given (without suffix).

    ``keep`` (H, W): pixels where it is False are written black.
    """
    import cv2

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for frame in sequence.frames():
        name = f"{names[frame.index] if names else f'{frame.index:06d}'}.png"
        image = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY) if grey else frame.image
        image = np.asarray(image)
        if keep is not None:
            image = np.where(keep if grey else keep[..., None], image, 0).astype(np.uint8)
        write_image(folder / name, image)
        written.append(name)
    return WrittenImages(folder, written)


def nanoseconds(times: NDArray[np.float64]) -> list[str]:
    """Times in whole nanoseconds, as EuRoC names its images."""
    return [str(round(float(t) * 1e9)) for t in times]


def write_mask(camera: Camera, path: Path, keep: NDArray[np.bool_] | None = None) -> bool:
    """A PNG, 255 where pixels count (``keep``, or all valid ones); False (and no file) when all of them do."""
    valid = camera.valid_mask() if keep is None else keep
    if valid.all():
        return False
    write_image(path, valid)
    return True


def pixels_ahead(camera: Camera, half_angle_deg: float = 85.0) -> NDArray[np.bool_]:
    """(H, W): valid pixels whose rays lie within an angle of the optical axis.

    For programs that carry image points on the plane z = 1, where rays at 90 degrees are at infinity and those beyond
    come back from the other side.
    """
    valid = camera.valid_mask()
    return np.asarray(valid & (camera.rays()[..., 2] > np.cos(np.deg2rad(half_angle_deg))))


def frame_rate(times: NDArray[np.float64]) -> float:
    """Frames per second: the inverse of the median interval (1 for a single frame)."""
    return float(1.0 / np.median(np.diff(times))) if len(times) > 1 else 1.0


@dataclass(frozen=True)
class OpenCvPinhole:
    """Focal lengths, principal point (OpenCV's pixel centres) and k1 k2 p1 p2 k3."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]


def opencv_pinhole(camera: Camera, program: str) -> OpenCvPinhole:
    """Raises UnsupportedError if the camera is none, or has the rational distortion model."""
    if camera.kind != "pinhole":
        raise UnsupportedError(f"{program} takes pinhole images, not {camera.kind}; give --camera pinhole")
    v = camera.to_dict()
    d = tuple(float(x) for x in v.get("distortion", ()))
    if len(d) > 5 and any(d[5:]):
        raise UnsupportedError(f"{program} takes five distortion coefficients at most, this camera has {len(d)}")
    k1, k2, p1, p2, k3 = (*d[:5], *([0.0] * (5 - len(d[:5]))))
    return OpenCvPinhole(v["fx"], v["fy"], v["cx"] - 0.5, v["cy"] - 0.5, (k1, k2, p1, p2, k3))


@dataclass(frozen=True)
class OpenCvFisheye:
    """Kannala-Brandt with four coefficients, OpenCV's pixel centres."""

    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, ...]


def opencv_fisheye(camera: Camera) -> OpenCvFisheye:
    """A camera of kind "fisheye" in OpenCV's numbers."""
    v = camera.to_dict()
    return OpenCvFisheye(v["fx"], v["fy"], v["cx"] - 0.5, v["cy"] - 0.5, tuple(v["k"]))


def require_pyramid(camera: Camera, levels: int, factor: float, margin: int, program: str) -> None:
    """Raise UnsupportedError if the smallest of an image pyramid's levels has ``margin`` or fewer rows or columns.

    ORB extractors look for corners in what is left inside a margin, and crash when that is nothing.
    """
    side = min(camera.width, camera.height)
    fitting = sum(round(side / factor**level) > margin for level in range(levels))
    if fitting < levels:
        how = f"give a larger --width, or --set levels={fitting}" if fitting else "give a larger --width"
        size = f"{camera.width}x{camera.height}"
        raise UnsupportedError(f"{size} pixels are too few for {levels} pyramid levels of {program}; {how}")


def opencv_yaml(values: Mapping[str, Any]) -> str:
    """A file for OpenCV's FileStorage: numbers, strings, nested mappings (one level), 2-D arrays as matrices."""
    lines = ["%YAML:1.0", "---"]
    for key, value in values.items():
        if isinstance(value, Mapping):
            lines.append(f"{key}:")
            lines += [f"   {k}: {_scalar(v)}" for k, v in value.items()]
        elif isinstance(value, np.ndarray):
            data = ", ".join(_scalar(float(v)) for v in value.reshape(-1))
            rows, cols = value.shape
            lines += [
                f"{key}: !!opencv-matrix",
                f"   rows: {rows}",
                f"   cols: {cols}",
                "   dt: d",
                f"   data: [{data}]",
            ]
        else:
            lines.append(f"{key}: {_scalar(value)}")
    return "\n".join(lines) + "\n"


def _scalar(value: Any) -> str:
    """OpenCV tells real numbers from integers by the point, and reads a real where it wants one only."""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        text = repr(float(value))
        return text if any(c in text for c in ".n") else text.replace("e", ".0e")
    escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'

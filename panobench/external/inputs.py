"""Inputs of other people's programs: images, masks, time lists and calibration files.

OpenCV and the programs built on it put the centre of the first pixel at (0, 0), panobench puts it at (0.5, 0.5): the
principal points that are written here are half a pixel smaller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import write_image
from panobench.errors import UnsupportedError

if TYPE_CHECKING:
    from panobench.cameras.base import Camera


@dataclass(frozen=True)
class WrittenImages:
    """A folder and the names of the images in it, one per frame."""

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
    """Write PNG files in the order of the frames: 000000.png and so on, or ``names`` (without suffix).

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
    """Times in whole nanoseconds, by which EuRoC names its images."""
    return [str(round(float(t) * 1e9)) for t in times]


def write_mask(camera: Camera, path: Path, keep: NDArray[np.bool_] | None = None) -> bool:
    """Write a PNG that is 255 where pixels count (``keep``, or all valid ones); no file, and False, if all do."""
    valid = camera.valid_mask() if keep is None else keep
    if valid.all():
        return False
    write_image(path, valid)
    return True


def pixels_ahead(camera: Camera, half_angle_deg: float = 85.0) -> NDArray[np.bool_]:
    """(H, W): the valid pixels whose rays lie within an angle of the optical axis.

    For programs that carry image points to the plane z = 1, where rays at 90 degrees go to infinity and those beyond
    come back from the other side.
    """
    valid = camera.valid_mask()
    return np.asarray(valid & (camera.rays()[..., 2] > np.cos(np.deg2rad(half_angle_deg))))


def frame_rate(times: NDArray[np.float64]) -> float:
    """Frames per second: the inverse of the median interval, 1 for a single frame."""
    return float(1.0 / np.median(np.diff(times))) if len(times) > 1 else 1.0


@dataclass(frozen=True)
class OpenCvPinhole:
    """A pinhole camera in pixels with OpenCV's pixel centres; ``distortion`` is k1 k2 p1 p2 k3."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]


def opencv_pinhole(camera: Camera, program: str) -> OpenCvPinhole:
    """The camera in OpenCV's numbers. Raises UnsupportedError for other cameras, or rational distortion."""
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
    """A Kannala-Brandt camera in pixels with OpenCV's pixel centres; ``k`` holds four coefficients."""

    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, ...]


def opencv_fisheye(camera: Camera) -> OpenCvFisheye:
    """A camera of kind "fisheye" in OpenCV's numbers."""
    v = camera.to_dict()
    return OpenCvFisheye(v["fx"], v["fy"], v["cx"] - 0.5, v["cy"] - 0.5, tuple(v["k"]))


def intrinsics(camera: OpenCvPinhole | OpenCvFisheye) -> dict[str, float]:
    """fx, fy, cx and cy by name, for settings files."""
    return {"fx": float(camera.fx), "fy": float(camera.fy), "cx": float(camera.cx), "cy": float(camera.cy)}


def require_pyramid(camera: Camera, levels: int, factor: float, margin: int, program: str) -> None:
    """Raise UnsupportedError if the smallest level of the image pyramid has ``margin`` or fewer rows or columns.

    ORB extractors look for corners inside a margin, and crash when nothing is left inside it.
    """
    side = min(camera.width, camera.height)
    fitting = sum(round(side / factor**level) > margin for level in range(levels))
    if fitting < levels:
        how = f"give a larger --width, or --set levels={fitting}" if fitting else "give a larger --width"
        size = f"{camera.width}x{camera.height}"
        raise UnsupportedError(f"{size} pixels are too few for {levels} pyramid levels of {program}; {how}")


def opencv_yaml(values: Mapping[str, Any]) -> str:
    """Text for OpenCV's FileStorage: numbers, strings, mappings (one level deep), 2-D arrays as matrices."""
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
                f"   dt: {'f' if value.dtype == np.float32 else 'd'}",
                f"   data: [{data}]",
            ]
        else:
            lines.append(f"{key}: {_scalar(value)}")
    return "\n".join(lines) + "\n"


def _scalar(value: Any) -> str:
    """OpenCV tells a real number from an integer by its point, and programs insist on the type they expect."""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        text = repr(float(value))
        return text if any(c in text for c in ".n") else text.replace("e", ".0e")
    escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'

"""Reading and writing images and depth maps, with limits checked before decoding.

Every image becomes RGB uint8: grey is replicated, 16 bit is scaled by 255/65535, alpha is dropped.
EXIF orientation is ignored, because calibrations and masks refer to the pixels as stored.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.image_header import HEAD_BYTES, HeaderError, check_complete, image_size
from panobench.datasets.files.natural import natural_names
from panobench.errors import DatasetError

#: Larger images are refused before decoding: a damaged header must not take the machine's memory.
MAX_SIDE = 16384
MAX_PIXELS = 200_000_000
#: Image files that folders of frames are searched for.
IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jfif", ".insp"),  # Insta360's photographs are JPEGs
    *(".webp", ".tif", ".tiff", ".bmp", ".pgm", ".ppm"),
)


def check_limits(width: int, height: int, path: Path | str, frame: int | str | None = None) -> None:
    """Raise DatasetError for an empty or too large image."""
    if width < 1 or height < 1:
        raise DatasetError(f"the image claims {width}x{height} pixels", path, frame=frame)
    if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
        raise DatasetError(
            f"the image claims {width}x{height} pixels; at most {MAX_SIDE} px a side and "
            f"{MAX_PIXELS // 1_000_000} million in all are read",
            path,
            frame=frame,
        )


def read_size(path: Path, *, frame: int | str | None = None) -> tuple[int, int]:
    """(width, height) from the file's header. Raises DatasetError if missing, foreign or over the limits."""
    try:
        with path.open("rb") as file:
            data = file.read(HEAD_BYTES)
            size = image_size(data)
            if size is None:
                size = image_size(data + file.read())
    except FileNotFoundError:
        raise DatasetError("the image is missing", path, frame=frame) from None
    except OSError as error:
        raise DatasetError(f"the image cannot be read ({error.strerror})", path, frame=frame) from error
    except HeaderError as error:
        raise DatasetError(str(error), path, frame=frame) from None
    if size is None:
        raise DatasetError("the image is truncated inside its header", path, frame=frame)
    check_limits(*size, path, frame)
    return size


def decode_stored(data: bytes, path: Path | str, frame: int | str | None = None) -> NDArray[Any]:
    """The file's pixels as stored (BGR order where it has colour). Raises DatasetError as ``decode_image``."""
    import cv2

    try:
        size = image_size(data)
        if size is not None:
            check_limits(*size, path, frame)
        check_complete(data)
    except HeaderError as error:
        raise DatasetError(str(error), path, frame=frame) from None
    try:
        pixels = cv2.imdecode(
            np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | getattr(cv2, "IMREAD_IGNORE_ORIENTATION", 128)
        )
    except cv2.error:
        pixels = None
    if pixels is None:
        raise DatasetError("the image is damaged and cannot be decoded", path, frame=frame)
    if size is not None and pixels.shape[:2] != (size[1], size[0]):  # a tag that stands twice, as a limit's way round
        raise DatasetError("the image is damaged: its header claims two sizes", path, frame=frame)
    return np.asarray(pixels)


def read_bytes(path: Path, what: str, frame: int | str | None = None) -> bytes:
    """A file's content. Raises DatasetError naming it, and ``what`` it is, where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise DatasetError(f"the {what} is missing", path, frame=frame) from None
    except OSError as error:
        raise DatasetError(f"the {what} cannot be read ({error.strerror})", path, frame=frame) from error


def to_rgb(pixels: NDArray[Any], path: Path | str = "image", frame: int | str | None = None) -> NDArray[np.uint8]:
    """Decoded pixels (H, W), (H, W, 1), or BGR(A), 8 or 16 bit -> RGB uint8 (H, W, 3)."""
    import cv2

    if pixels.dtype == np.uint16:
        pixels = ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise DatasetError(f"pixels of type {pixels.dtype} are not read; 8 or 16 bit are", path, frame=frame)
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    code = cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGB
    return np.asarray(cv2.cvtColor(pixels, code), dtype=np.uint8)


def decode_image(data: bytes, path: Path | str, *, frame: int | str | None = None) -> NDArray[np.uint8]:
    """An image file's bytes -> RGB uint8 (H, W, 3). Raises DatasetError if foreign, too large or truncated."""
    return to_rgb(decode_stored(data, path, frame), path, frame)


def read_image(path: Path, *, frame: int | str | None = None) -> NDArray[np.uint8]:
    """An image file -> RGB uint8 (H, W, 3). Raises DatasetError naming file and frame."""
    return decode_image(read_bytes(path, "image", frame), path, frame=frame)


def read_depth(path: Path, *, frame: int | str | None = None) -> NDArray[np.float32]:
    """Radial depth (H, W) float32 in metres, NaN where unknown, from .npy (metres) or 16-bit .png (millimetres).

    Zero, negative and infinite values are unknown.
    """
    if path.suffix.lower() == ".npy":
        try:
            stored = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError:
            raise DatasetError("the depth map is missing", path, frame=frame) from None
        except Exception as error:  # np.load lets out what its parsers raise: TokenError, BadZipFile, ...
            raise DatasetError(f"the depth map is damaged ({error})", path, frame=frame) from None
        if not isinstance(stored, np.ndarray):  # np.load opens archives of arrays, too
            stored.close()
            raise DatasetError("the depth map is no single array in .npy format", path, frame=frame)
        if stored.ndim == 3 and stored.shape[2] == 1:
            stored = stored[..., 0]
        if stored.ndim != 2 or stored.dtype.kind not in "fiu":
            raise DatasetError(
                f"the depth map has shape {stored.shape} and type {stored.dtype}; (H, W) numbers are expected",
                path,
                frame=frame,
            )
        check_limits(stored.shape[1], stored.shape[0], path, frame)
        depth = np.array(stored, dtype=np.float32)
    else:
        stored = decode_stored(read_bytes(path, "depth map", frame), path, frame)
        if stored.dtype != np.uint16 or stored.ndim != 2:
            raise DatasetError("a depth PNG must be single-channel 16 bit, millimetres", path, frame=frame)
        depth = stored.astype(np.float32) * np.float32(1e-3)
    with np.errstate(invalid="ignore"):
        depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def resize_image(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """RGB (H, W, 3) at another size: area filter when it shrinks, bilinear when it grows."""
    import cv2

    h, w = image.shape[:2]
    if (w, h) == (width, height):
        return image
    method = cv2.INTER_AREA if width <= w and height <= h else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (width, height), interpolation=method), dtype=np.uint8)


def resize_depth(depth: NDArray[np.float32], width: int, height: int, *, wrap: bool = False) -> NDArray[np.float32]:
    """Radial depth at another size, sampled at the new pixel centres.

    Bilinear in inverse depth (linear across planes) where the four neighbours lie within 5% of each
    other, nearest elsewhere, so that edges stay edges and NaN does not spread. ``wrap``: the left
    and right borders are neighbours (a full panorama).
    """
    h, w = depth.shape
    if (w, h) == (width, height):
        return depth
    u = (np.arange(width) + 0.5) * w / width - 0.5
    v = (np.arange(height) + 0.5) * h / height - 0.5
    u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
    fu = (u - u0).astype(np.float32)[None, :]
    fv = (v - v0).astype(np.float32)[:, None]
    columns = [(u0 + k) % w if wrap else np.clip(u0 + k, 0, w - 1) for k in (0, 1)]
    rows = [np.clip(v0 + k, 0, h - 1) for k in (0, 1)]
    corners = [depth[np.ix_(r, c)] for r in rows for c in columns]
    near = np.where(fv < 0.5, np.where(fu < 0.5, corners[0], corners[1]), np.where(fu < 0.5, corners[2], corners[3]))
    low = np.minimum.reduce(corners)
    high = np.maximum.reduce(corners)
    with np.errstate(invalid="ignore"):
        smooth = high < 1.05 * low  # False wherever a corner is NaN
    weights = ((1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu)
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = sum(k / c for k, c in zip(weights, corners))
        return np.where(smooth, 1.0 / inverse, near).astype(np.float32)


def encode_image(image: NDArray[Any], suffix: str, *, quality: int = 95) -> bytes:
    """RGB (H, W, 3) or grey/bool (H, W) -> file bytes; suffix ".png", ".jpg", ".webp", ".tif" or ".ppm"."""
    import cv2

    pixels = np.where(image, 255, 0).astype(np.uint8) if image.dtype == np.bool_ else image
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    options = {
        ".jpg": [cv2.IMWRITE_JPEG_QUALITY, quality],
        ".png": [cv2.IMWRITE_PNG_COMPRESSION, 3],
        ".webp": [cv2.IMWRITE_WEBP_QUALITY, quality],
        ".tif": [],
        ".ppm": [],
    }[suffix]
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(pixels), options)
    if not ok:
        raise ValueError(f"cv2 could not encode a {pixels.shape} {pixels.dtype} image as {suffix}")
    return bytes(data)


def write_image(path: Path, image: NDArray[Any], *, quality: int = 95) -> None:
    """Write RGB (H, W, 3) or grey/bool (H, W) as the suffix says. Raises OSError, which cv2.imwrite may not."""
    path.write_bytes(encode_image(image, path.suffix, quality=quality))


def encode_depth(depth: NDArray[np.float32]) -> bytes:
    """Radial depth in metres -> bytes of a .npy file, float32 (exact, NaN kept)."""
    import io

    buffer = io.BytesIO()
    np.save(buffer, np.asarray(depth, dtype=np.float32), allow_pickle=False)
    return buffer.getvalue()


def list_images(folder: Path) -> list[Path]:
    """Image files directly in ``folder``, in natural order of their names; hidden files are skipped."""
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if e.name[0] != "." and e.name.lower().endswith(IMAGE_SUFFIXES)]
    return [folder / name for name in natural_names(names)]

"""Pixels of sensor_msgs/Image and sensor_msgs/CompressedImage.

Encodings are those of sensor_msgs/image_encodings.h. Bayer patterns and YUV are converted by OpenCV, as cv_bridge and
image_proc do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.image_header import HeaderError, image_size
from panobench.datasets.files.images import MAX_SIDE, check_limits, decode_stored, to_rgb
from panobench.errors import DatasetError

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


class Encoding(NamedTuple):
    """channels and bits of a pixel as stored, and OpenCV's conversion of them to RGB (None: grey or RGB already)."""

    channels: int
    bits: int = 8
    conversion: str | None = None


def _bayer(bits: int) -> dict[str, Encoding]:
    # OpenCV names a pattern by its second row and column, ROS by the first.
    opencv = {"rggb": "BayerBG2RGB", "bggr": "BayerRG2RGB", "gbrg": "BayerGR2RGB", "grbg": "BayerGB2RGB"}
    return {f"bayer_{pattern}{bits}": Encoding(1, bits, code) for pattern, code in opencv.items()}


#: Encodings of raw images that are read.
ENCODINGS = {
    "mono8": Encoding(1),
    "8uc1": Encoding(1),
    "mono16": Encoding(1, 16),
    "16uc1": Encoding(1, 16),
    "rgb8": Encoding(3),
    "bgr8": Encoding(3, 8, "BGR2RGB"),
    "8uc3": Encoding(3, 8, "BGR2RGB"),
    "rgba8": Encoding(4, 8, "RGBA2RGB"),
    "bgra8": Encoding(4, 8, "BGRA2RGB"),
    "8uc4": Encoding(4, 8, "BGRA2RGB"),
    "rgb16": Encoding(3, 16),
    "bgr16": Encoding(3, 16, "BGR2RGB"),
    "16uc3": Encoding(3, 16, "BGR2RGB"),
    "rgba16": Encoding(4, 16, "RGBA2RGB"),
    "bgra16": Encoding(4, 16, "BGRA2RGB"),
    "16uc4": Encoding(4, 16, "BGRA2RGB"),
    **_bayer(8),
    **_bayer(16),
    "yuv422": Encoding(2, 8, "YUV2RGB_UYVY"),
    "uyvy": Encoding(2, 8, "YUV2RGB_UYVY"),
    "yuv422_yuy2": Encoding(2, 8, "YUV2RGB_YUY2"),
    "yuyv": Encoding(2, 8, "YUV2RGB_YUY2"),
    "nv12": Encoding(1, 8, "YUV2RGB_NV12"),
    "nv21": Encoding(1, 8, "YUV2RGB_NV21"),
}
_READ = "mono, rgb(a) and bgr(a) of 8 or 16 bits, bayer, yuv422, nv12 and nv21 are read"


@dataclass(frozen=True)
class ImageAbout:
    """What a message says of its image: (w, h), and how its pixels are stored, "" if its file says so."""

    size: tuple[int, int]
    encoding: str

    @property
    def deep(self) -> bool:
        """More than 8 bits, of which a camera may use a part."""
        return self.encoding != "" and ENCODINGS[self.encoding].bits > 8


def is_empty(message: Any) -> bool:
    """An image without any pixels, as drivers publish for a frame they have lost."""
    return len(message.data) == 0


def about_image(message: Any, path: Path, frame: int) -> ImageAbout:
    """Checks everything but the pixels. Raises DatasetError for what cannot be an image, or is none that is read."""
    if message.__msgtype__ == COMPRESSED:
        return _about_compressed(message, path, frame)
    if not hasattr(message, "encoding"):
        raise DatasetError(f"a {message.__msgtype__} where an image was expected", path, frame=frame)
    name = str(message.encoding).lower()
    if name not in ENCODINGS:
        raise DatasetError(f"the image has encoding '{message.encoding}'; {_READ}", path, frame=frame)
    width, height, step, length = int(message.width), int(message.height), int(message.step), len(message.data)
    check_limits(width, height, path, frame)
    row = width * ENCODINGS[name].channels * ENCODINGS[name].bits // 8
    rows = height * 3 // 2 if name.startswith("nv") else height
    even = width % 2 == 0 if (ENCODINGS[name].conversion or "").startswith("YUV") else True
    if not even or not row <= step <= 8 * MAX_SIDE or length < step * (rows - 1) + row:
        raise DatasetError(f"a {width}x{height} {name} image cannot have {length} bytes", path, frame=frame)
    return ImageAbout((width, height), name)


def _about_compressed(message: Any, path: Path, frame: int) -> ImageAbout:
    if "compresseddepth" in str(message.format).lower():
        raise DatasetError("these are depth maps; choose the images with --topic", path, frame=frame)
    try:
        size = image_size(bytes(message.data))
    except HeaderError as error:
        kind = f" (format '{str(message.format)[:60]}')" if message.format else ""
        raise DatasetError(f"the compressed image is not read{kind}: {error}", path, frame=frame) from None
    if size is None:
        raise DatasetError("the compressed image is truncated", path, frame=frame)
    check_limits(*size, path, frame)
    return ImageAbout(size, "")


def decode_image_message(message: Any, path: Path, frame: int, bits: int = 16) -> NDArray[np.uint8]:
    """The image as RGB uint8 (H, W, 3). bits: how many of 16 the camera uses. Raises DatasetError."""
    about = about_image(message, path, frame)
    if message.__msgtype__ == COMPRESSED:
        return _decode_compressed(message, path, frame)
    encoding = ENCODINGS[about.encoding]
    pixels = to_8_bits(_pixels(message, about), bits)
    rgb = _convert(pixels, encoding.conversion)
    return to_rgb(rgb, path, frame) if rgb.ndim == 2 else rgb


def _pixels(message: Any, about: ImageAbout) -> NDArray[Any]:
    """(H, W) or (H, W, channels), as stored; (3H/2, W) for NV12 and NV21."""
    encoding = ENCODINGS[about.encoding]
    width, height = about.size
    rows, step = (height * 3 // 2 if about.encoding.startswith("nv") else height), int(message.step)
    data = np.frombuffer(np.ascontiguousarray(message.data), np.uint8)[: step * rows]
    padded = data if len(data) == step * rows else np.concatenate([data, np.zeros(step * rows - len(data), np.uint8)])
    row = width * encoding.channels * encoding.bits // 8
    pixels: NDArray[Any] = np.ascontiguousarray(padded.reshape(rows, step)[:, :row])
    if encoding.bits == 16:
        pixels = pixels.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    return pixels.reshape(rows, width, encoding.channels) if encoding.channels > 1 else pixels


def most_bits(message: Any, path: Path, frame: int) -> int:
    """How many bits the brightest pixel needs; 0 for images of 8 bits."""
    about = about_image(message, path, frame)
    return int(_pixels(message, about).max()).bit_length() if about.deep else 0


def to_8_bits(pixels: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """Pixels of which so many bits are used, the highest value as 255."""
    if pixels.dtype == np.uint8:
        return pixels
    highest = (1 << bits) - 1
    scaled = (np.minimum(pixels, highest).astype(np.uint32) * 255 + highest // 2) // highest
    return scaled.astype(np.uint8)


def _convert(pixels: NDArray[np.uint8], conversion: str | None) -> NDArray[np.uint8]:
    import cv2

    if conversion is None:
        return pixels
    return np.asarray(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}")), dtype=np.uint8)


def _decode_compressed(message: Any, path: Path, frame: int) -> NDArray[np.uint8]:
    """JPEG, PNG, WebP or BMP. The format may say that it holds a Bayer pattern: "bayer_rggb8; jpeg compressed"."""
    stored = decode_stored(bytes(message.data), path, frame)
    original, _, packed = str(message.format).lower().partition(";")
    encoding = ENCODINGS.get(original.strip())
    grey = stored.ndim == 2 or stored.shape[2] == 1
    as_colour = any(name in packed for name in ("bgr", "rgb", "mono"))
    if grey and encoding is not None and "Bayer" in (encoding.conversion or "") and not as_colour:
        return _convert(to_8_bits(stored.reshape(stored.shape[:2]), 16), encoding.conversion)
    return to_rgb(stored, path, frame)

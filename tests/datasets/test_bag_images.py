"""Images in bags: every encoding there is, compressed or not, and what is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bag_samples as samples
import cv2
import numpy as np
import pytest
from bag_samples import SIZE, START, Recording, opened, write
from dataset_samples import panorama

from panobench.errors import DatasetError


@pytest.mark.parametrize("ros1", [True, False], ids=["ROS 1", "ROS 2"])
@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16", "rgb8", "bgr8", "8UC3", "rgba8", "bgra8", "rgb16",
                                      "bgr16", "bgra16", "yuv422", "yuv422_yuy2", "nv12", "nv21"])  # fmt: skip
def test_encodings(tmp_path: Path, encoding: str, ros1: bool) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(3)):
            recording.add("/cam", encoded(recording, t, panorama(i), encoding))

    sequence = opened(write(tmp_path / "walk", fill, "ros1" if ros1 else "mcap"))
    shown = sequence.image(1).astype(int)
    expected = panorama(1)
    if encoding in ("mono8", "8UC1", "mono16"):
        expected = np.repeat(cv2.cvtColor(expected, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)
    tolerance = 12 if encoding.startswith(("yuv", "nv")) else 1
    assert np.abs(shown - expected).max() <= tolerance


def encoded(recording: Recording, time: float, rgb: np.ndarray, encoding: str) -> Any:
    make = recording.messages.image
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    if encoding in ("mono8", "8UC1"):
        return make(time, grey, encoding)
    if encoding == "mono16":  # as cameras on the network send it
        return make(time, (grey.astype(">u2") * 257), encoding, is_bigendian=1)
    if encoding in ("yuv422", "yuv422_yuy2"):
        yuv = studio_yuv(rgb)
        packed = np.zeros((*grey.shape, 2), np.uint8)
        luma, chroma = (1, 0) if encoding == "yuv422" else (0, 1)
        packed[..., luma] = yuv[..., 0]
        packed[:, 0::2, chroma], packed[:, 1::2, chroma] = yuv[:, 0::2, 1], yuv[:, 0::2, 2]
        return make(time, packed, encoding)
    if encoding in ("nv12", "nv21"):
        yuv = studio_yuv(rgb)
        first, second = (1, 2) if encoding == "nv12" else (2, 1)
        chroma = np.stack([yuv[0::2, 0::2, first], yuv[0::2, 0::2, second]], axis=-1).reshape(-1, grey.shape[1])
        return make(time, np.concatenate([yuv[..., 0], chroma]), encoding, height=grey.shape[0])
    deep = encoding.endswith("16")
    stored = rgb if encoding.startswith("rgb") else rgb[..., ::-1]
    if "a" in encoding:
        stored = np.concatenate([stored, np.full((*grey.shape, 1), 9, np.uint8)], axis=2)
    return make(time, stored.astype(np.uint16) * 257 if deep else stored, encoding)


def studio_yuv(rgb: np.ndarray) -> np.ndarray:
    """BT.601 with the limited range of video."""
    r, g, b = np.moveaxis(rgb.astype(float) / 255, 2, 0)
    y = 16 + 65.481 * r + 128.553 * g + 24.966 * b
    u = 128 - 37.797 * r - 74.203 * g + 112 * b
    v = 128 + 112 * r - 93.786 * g - 18.214 * b
    return np.stack([y, u, v], axis=2).round().astype(np.uint8)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("how", ["8", "16", "jpeg", "png"])
def test_bayer_patterns(tmp_path: Path, pattern: str, how: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(2)):
            rgb = panorama(i)
            mosaic = np.empty(rgb.shape[:2], np.uint8)
            for at, colour in enumerate(pattern):
                row, column = divmod(at, 2)
                mosaic[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
            if how in ("8", "16"):
                stored = mosaic if how == "8" else mosaic.astype(np.uint16) * 257
                recording.add("/cam", recording.messages.image(t, stored, f"bayer_{pattern}{how}"))
            else:
                suffix = ".png" if how == "png" else ".jpg"
                form = f"bayer_{pattern}8; {how} compressed bayer_{pattern}8"
                recording.add("/cam/compressed", recording.messages.compressed(t, mosaic, form, suffix))

    shown = opened(write(tmp_path / "walk", fill)).image(1).astype(int)
    inside = np.s_[2:-2, 2:-2]
    difference = np.abs(shown - panorama(1))[inside]
    assert difference.mean() < (12 if how == "jpeg" else 6)


def test_cameras_that_use_a_part_of_sixteen_bits(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(3)):
            grey = cv2.cvtColor(panorama(i), cv2.COLOR_RGB2GRAY)
            recording.add("/cam", recording.messages.image(t, grey.astype(np.uint16) * 16, "mono16"))

    sequence = opened(write(tmp_path / "walk", fill))
    grey = cv2.cvtColor(panorama(2), cv2.COLOR_RGB2GRAY).astype(int)
    assert np.abs(sequence.image(2)[..., 0] - grey).max() <= 1
    assert any("use 12 of 16 bits" in line for line in sequence.remarks())


@pytest.mark.parametrize(("form", "suffix"), [("jpeg", ".jpg"), ("rgb8; png compressed bgr8", ".png"), ("", ".webp")])
def test_compressed_images(tmp_path: Path, form: str, suffix: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times()):
            recording.add("/cam/compressed", recording.messages.compressed(t, panorama(i), form, suffix))

    sequence = opened(write(tmp_path / "walk", fill, "mcap"), topic="cam")
    assert np.abs(sequence.image(4).astype(int) - panorama(4)).mean() < 4


def test_padded_rows(tmp_path: Path) -> None:
    def fill(recording: Recording) -> None:
        wide = np.pad(panorama(0), ((0, 0), (0, 5), (0, 0)))
        for t in samples.times(2):
            recording.add("/cam", recording.messages.image(t, wide, width=SIZE[0]))

    np.testing.assert_array_equal(opened(write(tmp_path / "walk", fill)).image(0), panorama(0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoding": "32FC1"}, r"frame 1: the image has encoding '32FC1'; mono, rgb"),
        ({"height": 500}, r"frame 1: a 64x500 rgb8 image cannot have 6144 bytes"),
        ({"step": 10}, r"frame 1: a 64x32 rgb8 image cannot have 6144 bytes"),
        ({"width": 100_000}, r"frame 1: the image claims 100000x32 pixels"),
        ({"width": 62}, r"frame 1: the image is 62x32 pixels, the first one is 64x32"),
    ],
)
def test_images_that_are_none(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    def fill(recording: Recording) -> None:
        for i, t in enumerate(samples.times(2)):
            recording.add("/cam", recording.messages.image(t, panorama(i), **(change if i else {})))

    with pytest.raises(DatasetError, match=message) as caught:
        opened(write(tmp_path / "walk", fill, "mcap"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "form", "message"),
    [
        (b"\0\0\0\1gE", "h264", r"not read \(format 'h264'\): not a PNG, JPEG"),
        (b"\x89PNG\r\n", "16UC1; compressedDepth png", "these are depth maps; choose the images with --topic"),
    ],
)
def test_compressed_data_that_are_no_picture(tmp_path: Path, data: bytes, form: str, message: str) -> None:
    def fill(recording: Recording) -> None:
        image = recording.messages.compressed(START, panorama(0), form)
        image.data = np.frombuffer(data, np.uint8)
        recording.add("/cam/compressed", image)

    with pytest.raises(DatasetError, match=message):
        opened(write(tmp_path / "walk", fill))

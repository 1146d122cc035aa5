from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_samples import panorama, save

from panobench.datasets.files.image_header import image_size
from panobench.datasets.files.images import (
    decode_image,
    encode_image,
    read_depth,
    read_image,
    read_size,
    resize_depth,
)
from panobench.errors import DatasetError


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".bmp", ".tif", ".ppm"])
def test_size_from_the_header_and_colour_order(tmp_path: Path, suffix: str) -> None:
    image = np.zeros((20, 30, 3), np.uint8)
    image[..., 0] = 200  # red
    path = save(tmp_path / f"a{suffix}", image)
    assert read_size(path) == (30, 20)
    assert read_image(path)[10, 10, 0] == pytest.approx(200, abs=4)
    assert read_image(path)[10, 10, 2] == pytest.approx(0, abs=4)


def test_lossless_and_lossy_webp_headers() -> None:
    image = np.random.default_rng(0).integers(0, 255, (37, 53, 3), np.uint8)
    for quality in (80, 101):  # over 100: lossless
        data = bytes(cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])[1])
        assert image_size(data) == (53, 37)


def test_grey_sixteen_bit_and_alpha_become_rgb(tmp_path: Path) -> None:
    grey16 = np.array([[0, 257, 65535, 32896]], np.uint16)
    np.testing.assert_array_equal(read_image(save(tmp_path / "g16.png", grey16))[0, :, 1], [0, 1, 255, 128])
    grey = np.array([[7, 9]], np.uint8)
    np.testing.assert_array_equal(read_image(save(tmp_path / "g.png", grey)), np.repeat(grey[..., None], 3, axis=2))
    bgra = np.dstack([np.full((2, 2), c, np.uint8) for c in (1, 2, 3, 0)])
    cv2.imwrite(str(tmp_path / "a.png"), bgra)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[0, 0], [3, 2, 1])


def test_exif_orientation_is_ignored(tmp_path: Path) -> None:
    data = encode_image(panorama(0), ".jpg")
    tiff = b"II*\0\x08\0\0\0" + struct.pack("<H", 1) + struct.pack("<HHII", 0x0112, 3, 1, 6) + b"\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    rotated = data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]
    assert decode_image(rotated, "x.jpg").shape == (32, 64, 3)
    np.testing.assert_array_equal(decode_image(rotated, "x.jpg"), decode_image(data, "x.jpg"))


def test_an_end_marker_inside_an_embedded_thumbnail_does_not_hide_truncation() -> None:
    data = encode_image(panorama(0), ".jpg")
    thumbnail = b"\xff\xd8 a small picture \xff\xd9"
    whole = data[:2] + b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail + data[2:]
    decode_image(whole, "x.jpg")
    with pytest.raises(DatasetError, match="truncated"):
        decode_image(whole[:-200], "x.jpg")
    decode_image(whole + b"trailer some cameras append", "x.jpg")


def test_tiff_and_netpbm_as_other_programs_write_them(tmp_path: Path) -> None:
    from PIL import Image

    image = panorama(0)
    for name, options in {
        "raw": {},
        "lzw": {"compression": "tiff_lzw"},
        "deflate": {"compression": "tiff_deflate"},
    }.items():
        Image.fromarray(image).save(tmp_path / f"{name}.tif", **options)
        np.testing.assert_array_equal(read_image(tmp_path / f"{name}.tif"), image)
    big_endian = b"MM\0*" + struct.pack(">IHHHIHHHHIHH", 8, 2, 256, 3, 1, 64, 0, 257, 3, 1, 32, 0)
    assert image_size(big_endian) == (64, 32)
    assert image_size(b"II*\0" + struct.pack("<I", 1 << 20)) is None
    (tmp_path / "a.pgm").write_bytes(b"P5 # made by hand\n# 7 8\n2 1\n255\n\x07\x09")
    assert read_size(tmp_path / "a.pgm") == (2, 1)
    np.testing.assert_array_equal(read_image(tmp_path / "a.pgm")[0, :, 0], [7, 9])
    for bad in (b"P5 x 1 255", b"P6\n", b"II*\0" + struct.pack("<IH", 8, 0)):
        (tmp_path / "bad.ppm").write_bytes(bad + b"\0" * 20)
        with pytest.raises(DatasetError, match="does not say its width and height"):
            read_size(tmp_path / "bad.ppm")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".tif", ".ppm"])
def test_every_truncation_is_an_error_never_a_half_grey_image(suffix: str) -> None:
    data = encode_image(panorama(0), suffix)
    for length in np.linspace(0, len(data) - 2, 40).astype(int):
        with pytest.raises(DatasetError, match=r"f\.x, frame 3: "):
            decode_image(data[:length], "f.x", frame=3)


def test_garbage_never_raises_anything_else() -> None:
    rng = np.random.default_rng(1)
    for suffix in (".png", ".jpg", ".webp", ".bmp", ".tif", ".ppm"):
        data = bytearray(bytes(cv2.imencode(suffix, panorama(0))[1]))
        for _ in range(60):
            damaged = bytearray(data)
            for at in rng.integers(0, min(len(data), 200), 4):
                damaged[at] = rng.integers(0, 256)
            with contextlib.suppress(DatasetError):
                assert decode_image(bytes(damaged), "f").dtype == np.uint8


def test_depth_errors(tmp_path: Path) -> None:
    save(tmp_path / "d.png", np.zeros((4, 8), np.uint8))
    with pytest.raises(DatasetError, match="16 bit"):
        read_depth(tmp_path / "d.png")
    np.save(tmp_path / "d.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DatasetError, match="damaged"):
        read_depth(tmp_path / "d.npy")
    np.save(tmp_path / "d.npy", np.zeros((4, 8, 3), np.float32))
    with pytest.raises(DatasetError, match="shape"):
        read_depth(tmp_path / "d.npy")
    (tmp_path / "d.npy").write_bytes((tmp_path / "d.npy").read_bytes()[:150])
    with pytest.raises(DatasetError, match="damaged"):
        read_depth(tmp_path / "d.npy")


def test_resized_depth_is_sampled_at_the_new_pixel_centres() -> None:
    # A wall seen in a panorama: radial depth 2 / cos(lon); inverse depth is smooth, so the error is tiny.
    def wall(width: int) -> np.ndarray:
        lon = ((np.arange(width) + 0.5) / width - 0.5) * 2.0
        return np.tile((2 / np.cos(lon)).astype(np.float32), (width // 2, 1))

    np.testing.assert_allclose(resize_depth(wall(200), 100, 50), wall(100), rtol=1e-3)
    np.testing.assert_allclose(resize_depth(wall(100), 200, 100)[:, 4:-4], wall(200)[:, 4:-4], rtol=1e-3)


def test_resized_depth_keeps_edges_and_unknown_pixels_apart() -> None:
    depth = np.full((8, 16), 1.0, np.float32)
    depth[:, 8:] = 4.0
    depth[2, 2] = np.nan
    big = resize_depth(depth, 32, 16, wrap=True)
    assert set(np.unique(big[np.isfinite(big)])) == {np.float32(1.0), np.float32(4.0)}
    assert np.isnan(big).sum() == 4
    small = resize_depth(depth, 8, 4)
    assert set(np.unique(small[np.isfinite(small)])) == {np.float32(1.0), np.float32(4.0)}


def test_a_tiff_whose_width_stands_twice_is_refused(tmp_path: Path) -> None:
    """Readers differ in which of two tags they take, so that limits could be checked on the wrong one."""
    data = bytearray(cv2.imencode(".tif", np.full((16, 32), 90, np.uint8))[1].tobytes())
    directory = int.from_bytes(data[4:8], "little")
    for k in range(int.from_bytes(data[directory : directory + 2], "little")):
        entry = directory + 2 + 12 * k
        if int.from_bytes(data[entry : entry + 2], "little") == 284:  # planar configuration: a second width
            data[entry : entry + 2] = (256).to_bytes(2, "little")
            data[entry + 8 : entry + 10] = (1).to_bytes(2, "little")
    path = tmp_path / "twice.tif"
    path.write_bytes(bytes(data))
    with pytest.raises(DatasetError):
        read_image(path)

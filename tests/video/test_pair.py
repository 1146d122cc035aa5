"""Recordings of two lenses: two streams in one file, two files, and GoPro's strips."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from clips import clip, number, numbered
from packed_spheres import projected, resized, world

from panobench.datasets.formats.video import Video
from panobench.errors import DatasetError
from panobench.video.pair import PairReader, even_strip, is_strip, open_recording, other_lens
from panobench.video.reader import VideoReader

TICKS = 90_000


def two_streams(path: Path, first: list[np.ndarray], second: list[np.ndarray], late: float = 0.0) -> Path:
    """10 frames a second in two streams; the second's are ``late`` seconds later."""
    with av.open(str(path), "w", format="mp4") as container:
        streams = []
        for pictures in (first, second):
            stream = container.add_stream("libx264", rate=10, options={"crf": "6"})
            stream.height, stream.width = pictures[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
            streams.append(stream)
        for stream, pictures, delay in zip(streams, (first, second), (0.0, late)):
            for k, picture in enumerate(pictures):
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
                frame.pts, frame.time_base = round((k / 10 + delay) * TICKS), Fraction(1, TICKS)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    return path


def squares(start: int, count: int) -> list[np.ndarray]:
    return [numbered(start + k, (128, 128)) for k in range(count)]


def test_two_streams_are_beside_each_other(tmp_path: Path) -> None:
    reader = open_recording(two_streams(tmp_path / "v.insv", squares(0, 5), squares(100, 5)))
    assert isinstance(reader, PairReader)
    assert (reader.width, reader.height, len(reader)) == (256, 128, 5)
    for index in (3, 0, 4):
        picture = reader.read(index)
        assert (number(picture[:, :128]), number(picture[:, 128:])) == (index, 100 + index)
    assert reader.read(2, (128, 64)).shape == (64, 128, 3)
    assert (reader.missing, reader.flawed, reader.rate) == ([], [], pytest.approx(10))
    assert reader.files() == [tmp_path / "v.insv"]


def test_frames_are_those_taken_together(tmp_path: Path) -> None:
    path = two_streams(tmp_path / "v.insv", squares(0, 8), squares(100, 5), late=0.2)
    reader = PairReader(path)
    np.testing.assert_allclose(reader.times, np.arange(2, 7) / 10, atol=1e-3)
    picture = reader.read(0)
    assert (number(picture[:, :128]), number(picture[:, 128:])) == (2, 100)
    apart = two_streams(tmp_path / "w.insv", squares(0, 3), squares(100, 3), late=9.0)
    with pytest.raises(DatasetError, match="not taken at the same times"):
        PairReader(apart)
    unequal = two_streams(tmp_path / "x.insv", squares(0, 3), [resized(p, 64, 64) for p in squares(0, 3)])
    with pytest.raises(DatasetError, match="128x128 and 64x64"):
        PairReader(unequal)


def test_a_small_preview_beside_the_video_is_no_second_lens(tmp_path: Path) -> None:
    path = two_streams(tmp_path / "v.mp4", [world()] * 3, [resized(world(), 128, 64)] * 3)
    assert isinstance(open_recording(path), VideoReader)
    assert Video(path).open().image(0).shape == (256, 512, 3)


def test_the_two_files_of_a_recording(tmp_path: Path) -> None:
    front, back = tmp_path / "VID_20260101_120000_00_007.insv", tmp_path / "VID_20260101_120000_10_007.insv"
    for path, start in ((front, 0), (back, 100)):
        times = [k / 10 for k in range(4)]
        clip(tmp_path / "t.mp4", times, size=(128, 128), frame=lambda i, size, b=start: numbered(b + i, size))
        (tmp_path / "t.mp4").rename(path)
    assert other_lens(front) == back
    for path in (front, back):
        reader = open_recording(path)
        picture = reader.read(2)
        assert (number(picture[:, :128]), number(picture[:, 128:])) == (2, 102)
        assert reader.files() == [front, back]
    back.unlink()
    assert other_lens(front) is None
    assert isinstance(open_recording(front), VideoReader)
    assert Video(tmp_path).sequences() == [front.stem]


def test_two_circles_name_the_command_that_stitches_them(tmp_path: Path) -> None:
    circles = projected("e:dfisheye:h_fov=200:v_fov=200", 512, 256)
    path = two_streams(tmp_path / "v.insv", [circles[:, :256]] * 3, [circles[:, 256:]] * 3)
    with pytest.raises(DatasetError, match=r"two fisheye circles \(about 200 degrees\).*--layout fisheyes:200"):
        Video(path).open()


def with_overlap(strip: np.ndarray, extra: int) -> np.ndarray:
    """A strip of three faces as two lenses would have recorded it: 3 * extra columns in the middle of the outer faces
    are there twice, 2 * extra wide.
    """
    h = strip.shape[0]
    half = 3 * extra // 2
    parts = []
    at = 0
    for middle in (h // 2, h * 5 // 2):
        seam = strip[:, middle - half : middle + half]
        shrunk = cv2.resize(seam, (2 * extra, h), interpolation=cv2.INTER_AREA)
        parts += [strip[:, at : middle - half], shrunk, shrunk]
        at = middle + half
    return np.concatenate([*parts, strip[:, at:]], axis=1)


def test_the_strips_of_a_gopro(tmp_path: Path) -> None:
    even = cv2.resize(projected("e:eac", 768 + 4, 512), (772, 512))[:, 2:-2]
    rows = [even[2:254], even[258:510]]
    rows = [cv2.resize(row, (768, 256)) for row in rows]
    stored = [with_overlap(row, 8) for row in rows]
    assert stored[0].shape == (256, 784, 3)
    assert is_strip((784, 256))
    assert not is_strip((512, 256))
    back = even_strip(stored[0], 768)
    assert np.abs(back.astype(int) - rows[0]).mean() < 1.5
    path = two_streams(tmp_path / "GS010001.360", [stored[0]] * 3, [stored[1]] * 3)
    sequence = Video(path).open(width=256)
    assert np.abs(sequence.image(1).astype(int) - resized(world(), 256, 128)).mean() < 6
    assert any("two streams of three faces" in remark for remark in sequence.remarks())
    assert sequence.provenance()["layout"]["name"] == "eac"
    plain = two_streams(tmp_path / "GS010002.360", [rows[0]] * 3, [rows[1]] * 3)
    assert np.abs(Video(plain).open(width=256).image(1).astype(int) - resized(world(), 256, 128)).mean() < 6

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from clips import SIZE, TICKS, clip, copied, number

from panobench.errors import DatasetError
from panobench.video.reader import VideoReader

EVEN = [i / 30 for i in range(90)]
#: 30 frames per second in light, 10 in the dark: what a phone does.
EXPOSURE = np.concatenate([[0.0], np.cumsum([1 / 30 if i // 20 % 2 == 0 else 1 / 10 for i in range(1, 90)])]).tolist()
#: One frame in fifteen is not there.
DROPPED = [(i + i // 15) / 30 for i in range(90)]
#: The recorder started, and went on half a second later.
LATE = [0.0] + [0.5 + i / 30 for i in range(1, 90)]

CASES = [
    ("exposure.mp4", EXPOSURE, {"g": 20, "bf": 2}),
    ("exposure.mkv", EXPOSURE, {"g": 20, "bf": 2}),
    ("dropped.mkv", DROPPED, {"g": 20, "bf": 2}),
    ("dropped.webm", DROPPED, {"codec": "libvpx-vp9", "deadline": "realtime", "cpu-used": 8, "g": 20}),
    (
        "hidden.webm",
        EVEN,
        {"codec": "libvpx", "deadline": "good", "cpu-used": 8, "auto-alt-ref": 1, "lag-in-frames": 16},
    ),
    ("late.mp4", LATE, {"g": 20, "bf": 2}),
    ("late.mov", LATE, {"g": 500, "bf": 3}),
    ("open-gop.ts", EXPOSURE, {"g": 20, "bf": 3, "x264-params": "open-gop=1"}),
    ("no-keyframes.ts", EVEN, {"g": 20, "bf": 0, "x264-params": "intra-refresh=1"}),
    ("hevc.mkv", EXPOSURE, {"codec": "libx265", "x265-params": "log-level=none:open-gop=1:keyint=20:bframes=3"}),
    ("reordered.avi", EVEN, {"rate": 30, "g": 20, "bf": 2}),
    ("mpeg4.avi", EVEN, {"codec": "mpeg4", "rate": 30, "g": 20, "b": "2M"}),
    ("mjpeg.avi", EVEN, {"codec": "mjpeg", "pixels": "yuvj420p", "rate": 30}),
    ("programme.mpg", EVEN, {"codec": "mpeg2video", "rate": 30, "g": 15, "bf": 2, "b": "2M"}),
    ("prores.mov", EXPOSURE, {"codec": "prores_ks", "pixels": "yuv422p10le"}),
]


@pytest.mark.parametrize(("name", "times", "options"), CASES, ids=[name for name, _, _ in CASES])
def test_every_frame_has_its_time_and_number_however_it_is_reached(
    name: str, times: list[float], options: dict, tmp_path: Path
) -> None:
    reader = VideoReader(clip(tmp_path / name, times, **options))
    assert len(reader) == len(times)
    np.testing.assert_allclose(reader.times, times, atol=0.6e-3)  # Matroska rounds to milliseconds
    images = [reader.read(i) for i in range(len(reader))]
    assert [number(image) for image in images] == list(range(len(times)))
    fresh = VideoReader(reader.path)
    for index in [len(times) - 1, 0, 61, 60, 62, 3, 3, 45, 88, 19, 20, 21, *range(40, 30, -1)]:
        np.testing.assert_array_equal(fresh.read(index), images[index], err_msg=f"{name}, frame {index}")
    assert fresh.missing == reader.missing == []


def test_a_late_first_frame_is_time_zero_and_the_rate_is_the_usual_one(tmp_path: Path) -> None:
    reader = VideoReader(clip(tmp_path / "v.ts", [1.5 + t for t in LATE], g=20))
    assert reader.times[0] == 0
    assert reader.times[1] == pytest.approx(0.5 + 1 / 30)
    assert reader.rate == pytest.approx(30, abs=0.1)


def test_an_edit_list_hides_what_is_decoded_for_others_sake(tmp_path: Path) -> None:
    whole = clip(tmp_path / "w.mp4", EVEN, g=30, bf=0)
    cut = tmp_path / "cut.mp4"
    with av.open(str(whole)) as source, av.open(str(cut), "w") as out:  # as `ffmpeg -ss 0.4 -c copy` cuts
        stream = source.streams.video[0]
        copy = out.add_stream_from_template(stream)
        for packet in source.demux(stream):
            if packet.size:
                packet.stream, packet.pts, packet.dts = (
                    copy,
                    packet.pts - 12 * TICKS // 30,
                    packet.dts - 12 * TICKS // 30,
                )
                out.mux(packet)
    reader = VideoReader(cut)
    assert number(reader.read(0)) == 12
    assert len(reader) == 90 - 12


@pytest.mark.parametrize("name", ["v.mp4", "v.mkv", "v.ts", "v.webm"])
def test_lost_packets_leave_the_other_frames_their_times(name: str, tmp_path: Path) -> None:
    options = {"codec": "libvpx-vp9", "deadline": "realtime", "cpu-used": 8} if name.endswith("webm") else {"bf": 0}
    whole = clip(tmp_path / f"whole.{name[2:]}", EVEN, g=10, **options)
    reader = VideoReader(copied(whole, tmp_path / name, keep=lambda i: not 38 <= i < 40))
    assert len(reader) == 88
    kept = [i for i in range(90) if i not in (38, 39)]
    np.testing.assert_allclose(reader.times, np.array(EVEN)[kept], atol=0.6e-3)
    found = [number(reader.read(i)) for i in range(88)]
    assert found == kept


def test_a_clip_that_begins_between_keyframes_begins_at_the_first_frame_there_is(tmp_path: Path) -> None:
    whole = clip(tmp_path / "w.mkv", EVEN, g=30, bf=0)
    reader = VideoReader(copied(whole, tmp_path / "v.mkv", keep=lambda i: i >= 20))
    assert number(reader.read(0)) == 30
    assert (len(reader), reader.index.lost, reader.times[0]) == (60, 10, 0.0)


def test_a_damaged_frame_is_counted_and_the_one_before_stands_in_for_it(tmp_path: Path) -> None:
    whole = clip(tmp_path / "w.mp4", EVEN, g=15, bf=0)
    path = copied(whole, tmp_path / "v.mp4", spoil=lambda i, b: bytes(len(b)) if i in (40, 41) else b)
    in_order, at_once = VideoReader(path), VideoReader(path)
    images = [in_order.read(i) for i in range(90)]
    assert in_order.missing == [40, 41]
    assert [number(image) for image in images[:43]] == [*range(40), 39, 39, number(images[42])]
    assert [number(image) for image in images[45:]] == list(range(45, 90))
    for index in (41, 89, 40, 0, 42):
        np.testing.assert_array_equal(at_once.read(index), images[index])
    assert at_once.missing == [40, 41]


def test_a_truncated_recording_ends_where_it_was_cut(tmp_path: Path) -> None:
    for name in ("v.mkv", "v.ts"):
        path = clip(tmp_path / name, EVEN, g=10, bf=0)
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
        reader = VideoReader(path)
        assert 40 < len(reader) < 75
        assert number(reader.read(len(reader) - 1)) == len(reader) - 1


def test_a_stream_without_stamps_says_what_rate_it_assumes(tmp_path: Path) -> None:
    reader = VideoReader(clip(tmp_path / "v.h264", EVEN, rate=30, g=20, bf=2))
    assert len(reader) == 90
    assert reader.index.assumed_rate is not None
    assert number(reader.read(70)) == 70


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_the_rotation_in_the_container_is_applied(degrees: int, tmp_path: Path) -> None:
    def corner(index: int, size: tuple[int, int]) -> np.ndarray:
        image = np.full((size[1], size[0], 3), 40, np.uint8)
        image[:16, :24] = 230  # upper left
        return image

    path = clip(tmp_path / "v.mp4", EVEN[:3], frame=corner, bf=0)
    data = path.read_bytes()
    # The matrix of tkhd: fixed point 16.16, as players turn clockwise by ``degrees``.
    one = {0: (1, 0, 0, 1), 90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}[degrees]
    a, b, c, d = ((v * 65536).to_bytes(4, "big", signed=True) for v in one)
    zero, unit = bytes(4), (1 << 30).to_bytes(4, "big")
    upright = (65536).to_bytes(4, "big") + bytes(12) + (65536).to_bytes(4, "big") + bytes(12) + unit
    at = data.rindex(upright)
    path.write_bytes(data[:at] + a + b + zero + c + d + zero + zero + zero + unit + data[at + 36 :])
    reader = VideoReader(path)
    turned = degrees in (90, 270)
    assert (reader.width, reader.height) == (SIZE[::-1] if turned else SIZE)
    stored = corner(0, SIZE)
    expected = np.rot90(stored, -degrees // 90)
    np.testing.assert_allclose(reader.read(0).astype(int), expected, atol=24)
    half = reader.read(0, (reader.width // 2, reader.height // 2))
    np.testing.assert_allclose(half.astype(int), expected[::2, ::2], atol=24)
    assert ("clockwise" in reader.orientation.describe()) == turned


def colours(index: int, size: tuple[int, int]) -> np.ndarray:
    """Smooth in all channels."""
    u, v = np.meshgrid(np.linspace(0, 6, size[0]), np.linspace(0, 6, size[1]))
    return (128 + 100 * np.stack([np.sin(u), np.cos(v), np.sin(u + v)], axis=-1)).astype(np.uint8)


@pytest.mark.parametrize("matrix", [None, "ITU709", "ITU601", "BT2020"])
@pytest.mark.parametrize("full_range", [False, True])
@pytest.mark.parametrize("pixels", ["yuv420p", "yuv420p10le"])
def test_colours_are_those_of_the_matrix_and_range_in_the_stream(
    matrix: str | None, full_range: bool, pixels: str, tmp_path: Path
) -> None:
    from av.video.reformatter import ColorRange, Colorspace

    tag = {"ITU709": 1, "ITU601": 6, "BT2020": 9}.get(matrix or "")
    range_ = ColorRange.JPEG if full_range else ColorRange.MPEG
    image = colours(0, (256, 128))
    path = tmp_path / "v.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 256, 128, pixels
        stream.codec_context.options = {"crf": "4"}
        stream.codec_context.color_range = range_
        if tag is not None:
            stream.codec_context.colorspace = tag
        frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(
            format=pixels,
            dst_colorspace=Colorspace[matrix or "ITU601"],
            dst_color_range=range_,
        )
        frame.pts = 0
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    reader = VideoReader(path)
    error = np.abs(reader.read(0).astype(int) - image)
    assert error.mean() < 1.6  # another matrix is off by 5 and more, another range by 9
    half = cv2.resize(image, (128, 64), interpolation=cv2.INTER_AREA)
    assert np.abs(reader.read(0, (128, 64)).astype(int) - half).mean() < 1.6


def test_files_that_are_no_video_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(b"")
    with pytest.raises(DatasetError, match=r"v\.mp4: the video is empty$"):
        VideoReader(path)
    path.write_bytes(b"not a video" * 100)
    with pytest.raises(DatasetError, match="cannot be opened"):
        VideoReader(path)
    with pytest.raises(DatasetError, match="No such file"):
        VideoReader(tmp_path / "none.mp4")
    path.write_text("ffconcat version 1.0\nfile other.mp4\n")  # a list of files is not followed
    with pytest.raises(DatasetError, match="cannot be opened"):
        VideoReader(path)
    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        sound = av.AudioFrame.from_ndarray(np.zeros((2, 1024), np.float32), format="fltp", layout="stereo")
        sound.sample_rate, sound.pts = 44100, 0
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    with pytest.raises(DatasetError, match="sound but no video"):
        VideoReader(tmp_path / "sound.mp4")
    header = clip(tmp_path / "w.mkv", EVEN[:10]).read_bytes()
    (tmp_path / "h.mkv").write_bytes(header[: header.index(b"\x1f\x43\xb6\x75")])  # cut before the first cluster
    with pytest.raises(DatasetError, match=r"no frame|cannot be opened|no video"):
        VideoReader(tmp_path / "h.mkv")


def test_names_that_ffmpeg_would_take_for_something_else(tmp_path: Path) -> None:
    whole = clip(tmp_path / "w.mp4", EVEN[:5], bf=0).read_bytes()
    for name in (b"concat:a.mp4", b"50%d.mp4", b"Stra\xdfe.mp4", "Straße.mp4".encode()):
        path = Path(str(tmp_path), name.decode("utf-8", "surrogateescape"))
        path.write_bytes(whole)
        reader = VideoReader(path)
        assert [number(reader.read(i)) for i in (4, 0)] == [4, 0]


def test_memory_stays_bounded_for_large_pictures(tmp_path: Path) -> None:
    """A frame of 4096x2048 has 12 MiB, 24 in RGB: reading thirty of them small takes far less than all of them."""

    def wide(index: int, size: tuple[int, int]) -> np.ndarray:
        return np.full((size[1], size[0], 3), 4 * index, np.uint8)

    path = clip(tmp_path / "v.mp4", EVEN[:30], size=(4096, 2048), frame=wide, preset="ultrafast", g=10)
    code = (
        "import resource, sys; from pathlib import Path; from panobench.video.reader import VideoReader\n"
        "import av.video.reformatter, numpy\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # KiB on Linux\n"
        "before = peak(); reader = VideoReader(Path(sys.argv[1]))\n"
        "for i in range(len(reader)): reader.read(i, (64, 32))\n"
        "print((peak() - before) // 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 350

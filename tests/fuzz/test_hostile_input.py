"""Input made to do harm: claims of size, bombs, paths that lead elsewhere, code in weights, markup in names."""

from __future__ import annotations

import bz2
import contextlib
import io
import pickle
import resource
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from targets import material

from panobench.datasets.bags.files import BagFile
from panobench.datasets.files.images import decode_image, encode_image, read_depth, read_size
from panobench.datasets.formats.folder import Folder
from panobench.errors import CalibrationError, DatasetError, InputError, PanobenchError
from panobench.splat.ply import read_ply


@contextmanager
def bounded(mib: int = 400, seconds: float = 5.0) -> Iterator[None]:
    """No more than that much further memory, and no more than that much processor time."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    clock = time.process_time()
    resource.setrlimit(resource.RLIMIT_AS, (used + (mib << 20), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert time.process_time() - clock < seconds


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, rows: bytes = b"") -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.mark.parametrize(
    ("width", "height"), [(100_000, 50_000), (16_384, 16_384), (2**31 - 1, 1), (2**32 - 1, 2**32 - 1), (0, 5)]
)
def test_a_picture_that_claims_too_much_is_refused_unread(width: int, height: int, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(width, height))
    with bounded(), pytest.raises(DatasetError, match=rf"a\.png: the image claims {width}x{height} pixels"):
        read_size(path)
    with bounded(), pytest.raises(DatasetError, match=f"the image claims {width}x{height} pixels"):
        decode_image(path.read_bytes(), path)


def test_a_picture_with_more_rows_than_it_says_is_bounded_by_its_size() -> None:
    """A decompression bomb in IDAT: the decoder stops where the header says."""
    data = png(8, 4, b"\0" * (60 << 20))
    assert len(data) < 1 << 20
    with bounded(mib=100), contextlib.suppress(DatasetError):
        assert decode_image(data, "bomb.png").shape == (4, 8, 3)


def test_a_mask_beside_a_calibration_has_the_same_limits(tmp_path: Path) -> None:
    from panobench.cameras.calibration import read_calibration

    (tmp_path / "mask.png").write_bytes(png(100_000, 50_000))
    (tmp_path / "camera.yaml").write_text("model: erp\nwidth: 64\nheight: 32\nmask: mask.png\n")
    with bounded(), pytest.raises(CalibrationError, match=r"mask\.png is not an image"):
        read_calibration(tmp_path / "camera.yaml")


def test_pictures_of_a_stored_run_have_the_same_limits(tmp_path: Path) -> None:
    from panobench.report.images import read

    (tmp_path / "000001.png").write_bytes(png(100_000, 50_000))
    with bounded():
        assert read(tmp_path / "000001.png") is None


@pytest.mark.parametrize("count", [10**12, 10**30])
@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_a_map_that_claims_more_vertices_than_it_has(count: int, form: str, tmp_path: Path) -> None:
    text = material("ply").documents[0].split(b"end_header\n")[0].decode()
    text = text.replace("element vertex 3", f"element vertex {count}").replace("binary_little_endian", form)
    (tmp_path / "map.ply").write_bytes(text.encode() + b"end_header\n" + b"\0" * 1000)
    with bounded(), pytest.raises(InputError, match=r"map\.ply"):
        read_ply(tmp_path / "map.ply")


def test_a_depth_map_that_claims_a_petabyte(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.ones((2, 4)))
    data = buffer.getvalue().replace(b"(2, 4), }" + b" " * 20, b"(9999999999, 9999), }" + b" " * 8)
    (tmp_path / "d.npy").write_bytes(data)
    with bounded(), pytest.raises(DatasetError, match="the depth map"):
        read_depth(tmp_path / "d.npy")


def test_a_calibration_of_four_billion_pixels_makes_no_mask(tmp_path: Path) -> None:
    from panobench.cameras.calibration import read_calibration

    text = "model: pinhole\nwidth: 65536\nheight: 65536\nfx: 9\nfy: 9\ncx: 9\ncy: 9\n"
    (tmp_path / "camera.yaml").write_text(text + "annulus: {centre: [9, 9], r_min: 1, r_max: 90}\n")
    with bounded(), pytest.raises(CalibrationError, match="over 200 million pixels"):
        read_calibration(tmp_path / "camera.yaml")


def with_chunk(bag: bytes, packed: bytes) -> bytes:
    """The bag with the data of its (only) compressed chunk replaced; its index stays where it was or moves along."""
    at = bag.index(b"compression=bz2")
    start = bag.index(b"BZh", at)
    (length,) = struct.unpack_from("<I", bag, start - 4)
    moved = len(packed) - length
    out = bytearray(bag[: start - 4] + struct.pack("<I", len(packed)) + packed + bag[start + length :])
    field = out.index(b"index_pos=") + 10
    struct.pack_into("<Q", out, field, struct.unpack_from("<Q", out, field)[0] + moved)
    return bytes(out)


def test_a_compressed_chunk_of_a_bag_may_not_unpack_to_gigabytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panobench.datasets.bags.files.MAX_CHUNK_BYTES", 1 << 20)
    bag = material("bag").documents[1]
    assert b"compression=bz2" in bag
    path = tmp_path / "a.bag"

    def read() -> list[Any]:
        opened = BagFile(path)
        return list(opened.records({"/image"}))

    path.write_bytes(bag)
    assert len(read()) == 3
    bomb = bz2.compress(b"\0" * (40 << 20))
    assert len(bomb) < 100
    path.write_bytes(with_chunk(bag, bomb))
    with bounded(mib=30), pytest.raises(DatasetError, match="unpacks to more than 1 MiB"):
        read()
    path.write_bytes(with_chunk(bag, bz2.compress(b"\0" * 1000)[:-4]))
    with pytest.raises(DatasetError, match="incomplete stream"):
        read()


@pytest.mark.parametrize(
    "name", ["../secret.png", "/etc/passwd", "images/../../secret.png", "a/../../secret.png", "", "..", "\0"]
)
def test_names_in_tables_do_not_lead_out_of_a_sequence(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "sequence"
    (folder / "images").mkdir(parents=True)
    (tmp_path / "secret.png").write_bytes(encode_image(np.zeros((32, 64, 3), np.uint8), ".png"))
    (folder / "camera.yaml").write_text("model: erp\nwidth: 64\nheight: 32\n")
    (folder / "frames.csv").write_text(f"time,file\n0.0,{name}\n")
    with pytest.raises(DatasetError, match=r"frames\.csv:2"):
        Folder(folder).open()


@pytest.mark.parametrize("name", ["../mask.png", "/etc/passwd", "a/../../mask.png"])
def test_files_named_in_calibrations_lie_beside_them(name: str, tmp_path: Path) -> None:
    from panobench.cameras.calibration import read_calibration
    from panobench.datasets.formats.dual_fisheye import read_dual_fisheye
    from panobench.datasets.palvio.calibration import find_calibration

    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "mask.png").write_bytes(encode_image(np.ones((32, 64), bool), ".png"))
    (folder / "camera.yaml").write_text(f"model: erp\nwidth: 64\nheight: 32\nmask: {name}\n")
    with pytest.raises(CalibrationError, match="beside"):
        read_calibration(folder / "camera.yaml")
    (folder / "palvio.yaml").write_text(f"camera: {name}\n")
    with pytest.raises(CalibrationError, match="beside"):
        find_calibration(folder)
    (folder / "dual_fisheye.yaml").write_text(f"lenses:\n  - {{camera: {name}}}\n  - {{camera: {name}}}\n")
    with pytest.raises(CalibrationError, match="beside"):
        read_dual_fisheye(folder / "dual_fisheye.yaml")


def test_a_bag_s_topics_name_no_files(tmp_path: Path) -> None:
    """Topics are compared, never used as paths: one that looks like one is only a topic that is not there."""
    bag = material("bag").documents[0].replace(b"/image", b"../../")
    (tmp_path / "a.bag").write_bytes(bag)
    opened = BagFile(tmp_path / "a.bag")
    assert list(opened.topics) == ["../.."]
    with pytest.raises(DatasetError, match="has no topic '/image'"):
        opened.need("/image", ("sensor_msgs/msg/Image",))


class Malicious:
    """Runs code when it is unpickled."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.witness,)


def test_network_weights_run_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    from panobench.metrics.lpips import VARIABLE, find_lpips

    witness = tmp_path / "witness"
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    torch.save({}, tmp_path / "alex.pth")
    torch.save({"weight": Malicious(witness)}, tmp_path / "alexnet-owt.pth")
    with pytest.raises(PanobenchError, match=r"alexnet-owt\.pth: not a weights file"):
        find_lpips({})
    (tmp_path / "alexnet-owt.pth").write_bytes(pickle.dumps(Malicious(witness)))
    with pytest.raises(PanobenchError, match=r"alexnet-owt\.pth: not a weights file"):
        find_lpips({})
    assert not witness.exists()


def test_no_source_file_uses_a_loader_that_runs_code() -> None:
    import panobench

    forbidden = ("yaml.load(", "yaml.unsafe", "pickle.load", "allow_pickle=True", "weights_only=False", "shell=True")
    forbidden += ("os.system(", "marshal.load", "dill.", "joblib.load", "extractall(", "eval(")
    found = [
        f"{path.name}: {word}"
        for path in Path(panobench.__file__).parent.rglob("*.py")
        for word in forbidden
        if word in path.read_text(encoding="utf-8").replace("model.eval()", "").replace(".eval()", "")
    ]
    assert found == []

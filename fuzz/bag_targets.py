"""Bags with everything that is read of them, their messages, and archives."""

from __future__ import annotations

import io
import shutil
import tarfile
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mutate import Material
from target import Parse, Target, plain, text

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths:
    - a_0.db3
  compression_format: ""
  compression_mode: ""
"""


class _Store:
    """Makes and serialises messages of ROS 1 or 2."""

    def __init__(self, ros1: bool) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def data(self, message: Any) -> bytes:
        kind = message.__msgtype__
        return bytes(self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind))

    def header(self, i: int) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=10, nanosec=100 * i)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="c", **({"seq": i} if self.ros1 else {}))

    def image(self, i: int, encoding: str = "rgb8", bytes_a_pixel: int = 3) -> Any:
        data = np.arange(32 * 16 * bytes_a_pixel, dtype=np.uint64).astype(np.uint8)
        return self.make(
            _IMAGE, header=self.header(i), height=16, width=32, encoding=encoding, is_bigendian=0,
            step=32 * bytes_a_pixel, data=data,
        )  # fmt: skip

    def compressed(self, i: int, form: str, suffix: str) -> Any:
        picture = np.zeros((16, 32) if form.startswith("bayer") else (16, 32, 3), np.uint8)
        data = np.frombuffer(cv2.imencode(suffix, picture)[1].tobytes(), np.uint8)
        return self.make(_COMPRESSED, header=self.header(i), format=form, data=data)

    def vector(self, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", x=0.5, y=-1.0, z=9.8)

    def others(self, i: int) -> list[tuple[str, Any]]:
        """True poses, inertial samples and a camera."""
        turned = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8)
        pose = self.make("geometry_msgs/msg/Pose", position=self.vector("Point"), orientation=turned)
        nine = np.eye(3).reshape(-1)
        imu = self.make(
            "sensor_msgs/msg/Imu", header=self.header(i), orientation=turned, orientation_covariance=nine,
            angular_velocity=self.vector(), angular_velocity_covariance=nine, linear_acceleration=self.vector(),
            linear_acceleration_covariance=nine,
        )  # fmt: skip
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, width=0, height=0, do_rectify=False
        )
        matrices = {"d": np.zeros(5), "k": np.array([9, 0, 16, 0, 9, 8, 0, 0, 1.0]), "r": nine, "p": np.zeros(12)}
        info = self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(i), height=16, width=32, distortion_model="plumb_bob",
            binning_x=0, binning_y=0, roi=region, **{(k.upper() if self.ros1 else k): v for k, v in matrices.items()},
        )  # fmt: skip
        truth = self.make("geometry_msgs/msg/PoseStamped", header=self.header(i), pose=pose)
        return [("/gt", truth), ("/imu", imu), ("/camera_info", info)]


def _bag(kind: str, packing: str = "") -> bytes:
    """The bytes of a bag's file."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    store = _Store(kind == "ros1")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        writer: Any
        if kind == "ros1":
            writer = Writer1(path)
            if packing:
                writer.set_compression(Writer1.CompressionFormat[packing])
        else:
            plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=8, storage_plugin=plugin)
            if packing:
                writer.set_compression(CompressionMode[packing], CompressionFormat.ZSTD)
        with writer:
            known: dict[str, Any] = {}
            for i in range(3):
                for topic, message in [("/image", store.image(i)), *store.others(i)]:
                    if topic not in known:
                        known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store.store)
                    writer.write(known[topic], 10_000_000_000 + i, store.data(message))
        file = path if path.is_file() else next(p for p in path.iterdir() if p.name != "metadata.yaml")
        return file.read_bytes()


def _bags(*kinds: tuple[str, str], words: bytes) -> Callable[[], Material]:
    return lambda: Material(tuple(_bag(*kind) for kind in kinds), tuple(words.split(b" ")))


def _parse_bag(path: Path) -> None:
    from panobench.datasets.bags.dataset import Bag

    sequence = Bag(path).open()
    assert (np.diff(sequence.times) > 0).all()
    for i in (*range(len(sequence)), 0):
        assert sequence.image(i).shape == (sequence.camera.height, sequence.camera.width, 3)
    sequence.remarks()
    if sequence.groundtruth is not None:
        assert np.isfinite(sequence.groundtruth.T_wc).all()


_ENCODINGS = {"mono8": 1, "mono16": 2, "bgra8": 4, "rgb16": 6, "bayer_rggb8": 1, "bayer_grbg16": 2, "yuv422": 2}


def _image_messages() -> Material:
    store = _Store(False)
    raw = [store.data(store.image(0, encoding, size)) for encoding, size in _ENCODINGS.items()]
    words = [*_ENCODINGS, "nv12", "nv21", "8UC4", "16UC1", "32FC1", "yuv422_yuy2", "rgba16"]
    return Material(tuple(raw), tuple(w.encode() for w in words))


def _compressed_messages() -> Material:
    store = _Store(False)
    forms = [("jpeg", ".jpg"), ("rgb8; png compressed bgr8", ".png"), ("bayer_rggb8; jpeg compressed", ".jpg")]
    data = tuple(store.data(store.compressed(0, form, suffix)) for form, suffix in forms)
    return Material(
        data, (b"compressedDepth", b"\xff\xd8\xff", b"\x89PNG", b"IHDR", b"IEND", b"bayer_gbrg16;", b"mono8")
    )


def _message(kind: str) -> Callable[[Path], Parse]:
    def setup(folder: Path) -> Parse:
        from panobench.datasets.bags.files import BagFile, Place, Record
        from panobench.datasets.bags.images import decode_image_message, is_empty, most_bits

        (folder / "a.mcap").write_bytes(_bag("mcap"))
        bag = BagFile(folder / "a.mcap")

        def parse(path: Path) -> None:
            message = bag.parse(Record("/image", kind, Place(0, 0, 0), path.read_bytes()), 0)
            if is_empty(message):
                return
            decode_image_message(message, path, 0, bits=12)
            if kind == _IMAGE:
                most_bits(message, path, 0)

        return parse

    return setup


def _metadata(folder: Path) -> Parse:
    from panobench.datasets.bags.layout import _named, find_bags, storage_files
    from panobench.errors import DatasetError

    (folder / "a").mkdir(exist_ok=True)
    (folder / "a" / "a_0.db3").touch()

    def parse(path: Path) -> None:
        find_bags(folder)
        assert all(file.parent == folder / "a" for file in storage_files(folder / "a"))
        if not _named(path):  # the files themselves are gone by then
            raise DatasetError("describes nothing", path)

    return parse


def _archives() -> Material:
    files = {"room/images/1.png": b"one" * 50, "room/2.txt": b"two", "room/._2.txt": b"x"}
    documents = []
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", method) as packed:
            for name, data in files.items():
                packed.writestr(name, data)
        documents.append(out.getvalue())
    for mode in ("w:", "w:gz", "w:bz2", "w:xz"):
        out = io.BytesIO()
        with tarfile.open(fileobj=out, mode=mode, format=tarfile.GNU_FORMAT) as target:  # type: ignore[call-overload]
            for name, data in files.items():
                info = tarfile.TarInfo(name)
                info.size = len(data)
                target.addfile(info, io.BytesIO(data))
        documents.append(out.getvalue())
    return Material(
        tuple(documents), (b"PK\x03\x04", b"PK\x01\x02", b"ustar", b"../x", b"/etc/x", b"room/images", b"C:/x")
    )


def _unpack(folder: Path) -> Parse:
    from panobench.datasets.files.archive import unpack_into

    def parse(path: Path) -> None:
        target = folder / "inside" / "out"
        try:
            unpack_into(path, target)
        finally:
            shutil.rmtree(target, ignore_errors=True)
            outside = [p for p in folder.rglob("*") if p.is_file() and p != path]
            assert not outside, outside

    return parse


def _time_list(folder: Path) -> Parse:
    from panobench.datasets.files.image_times import image_times

    images = [folder / f"{name}.png" for name in "abc"]

    def parse(path: Path) -> None:
        found = image_times(images)
        assert (np.diff(found.times) > 0).all()
        assert len(found.times) == len(found.images) > 0

    return parse


TARGETS = (
    Target("bag-ros1", "a.bag", _bags(("ros1", ""), ("ros1", "BZ2"), ("ros1", "LZ4"), words=b"op= conn= /imu ../.."),
           plain(_parse_bag)),
    Target("bag-sqlite", "a.db3", _bags(("db3", ""), ("db3", "MESSAGE"), words=b"messages topics /imu timestamp"),
           plain(_parse_bag)),
    Target("bag-mcap", "a.mcap", _bags(("mcap", ""), ("mcap", "STORAGE"), words=b"ros2 cdr zstd lz4 /imu \x89MCAP0"),
           plain(_parse_bag)),
    Target("bag-metadata", "a/metadata.yaml", text(_METADATA, words="null - ../x /etc/x a_1.db3"), _metadata),
    Target("image-message", "image.cdr", _image_messages, _message(_IMAGE)),
    Target("compressed-message", "image.cdr", _compressed_messages, _message(_COMPRESSED)),
    Target("archive", "a.zip", _archives, _unpack),
    Target("times-list", "times.txt", text("0.0\n0.1\n0.2\n", "# t\n10 a.png\n11 b.png\n12 c.png\n", words="a.png"),
           _time_list),
)  # fmt: skip

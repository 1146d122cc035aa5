"""ROS 1 bags without ROS: topics, raw messages by index, and images, with errors a user can act on.

Built on the pure-Python `rosbags` package. Message layouts: ROS 1 serialisation is little-endian,
packed, strings and arrays preceded by a uint32 length; std_msgs/Header is seq, secs, nsecs, frame_id.
"""

from __future__ import annotations

import bz2
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.images import MAX_SIDE, check_limits
from panobench.errors import DatasetError

_MAGIC = b"#ROSBAG V2.0"
#: Encodings of sensor_msgs/Image that can be read, and their number of channels.
ENCODINGS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3}
#: A compressed chunk that unpacks to more bytes is refused; recorders write chunks of about a megabyte.
MAX_CHUNK_BYTES = 256 << 20


@dataclass(frozen=True)
class ImageHeader:
    """The fixed part of a sensor_msgs/Image: stamp in s, size, encoding, bytes per row, offset of the pixels."""

    stamp: float
    width: int
    height: int
    encoding: str
    step: int
    offset: int
    length: int


@contextmanager
def explained_bag_errors(path: Path) -> Iterator[None]:
    """Turn what `rosbags` raises for a damaged file into a DatasetError."""
    from rosbags.rosbag1 import ReaderError

    try:
        yield
    except ReaderError as error:
        reason = " ".join(str(a) for a in error.args)
        if "not indexed" in reason:
            hint = "the bag has no index (its recording was cut off); run `rosbag reindex` on a copy first"
        elif "magic" in reason or "empty" in reason:
            hint = "this is not a ROS 1 bag (version 2.0)"
        else:
            hint = f"the bag is truncated or damaged ({reason})"
        raise DatasetError(hint, path) from None
    except (struct.error, RuntimeError, AssertionError, ValueError, KeyError, IndexError, EOFError) as error:
        raise DatasetError(f"the bag is truncated or damaged ({type(error).__name__}: {error})", path) from None
    except MemoryError:
        raise DatasetError("the bag is damaged: a record claims more memory than there is", path) from None
    except OSError as error:
        raise DatasetError(f"the bag cannot be read ({error.strerror or error})", path) from error


class BagFile:
    """One ROS 1 bag, open for reading. Random access by message; thread-safe."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag1 import Reader
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self._lock = threading.RLock()
        self._types = get_typestore(Stores.ROS1_NOETIC)
        with explained_bag_errors(path):
            with path.open("rb") as file:
                if not file.read(len(_MAGIC)).startswith(_MAGIC):
                    raise DatasetError("this is not a ROS 1 bag (version 2.0)", path)
            self._reader = Reader(path)
            self._reader.open()
            chunks = self._reader.chunks
            for at, chunk in chunks.items():
                chunks[at] = chunk._replace(decompressor=_bounded(chunk.decompressor))
            self.topics = {
                name: (info.msgtype or "mixed types", info.msgcount) for name, info in self._reader.topics.items()
            }

    def describe_topics(self) -> str:
        """ "topic (type, n messages)" for all topics, for messages."""
        if not self.topics:
            return "the bag has no topic"
        return "it has: " + ", ".join(f"{n} ({t}, {c})" for n, (t, c) in sorted(self.topics.items()))

    def connections(self, topic: str, kind: str) -> list[Any]:
        """Connections of ``topic``. Raises DatasetError, listing the topics, if it is missing or of another type."""
        if topic not in self.topics:
            raise DatasetError(f"the bag has no topic '{topic}'; {self.describe_topics()}", self.path)
        found = self.topics[topic][0]
        if found != kind:
            raise DatasetError(f"topic '{topic}' has messages of type {found}, expected {kind}", self.path)
        return [c for c in self._reader.connections if c.topic == topic]

    def records(self, connections: list[Any]) -> Iterator[tuple[str, int, bytes]]:
        """(topic, receive time in ns, serialised message) in order of receive time, reading the file once."""
        with self._lock, explained_bag_errors(self.path):
            for connection, stamp, data in self._reader.messages(connections):
                yield connection.topic, stamp, data

    def parse(self, data: bytes, topic: str, kind: str, index: int) -> Any:
        """A message as an object. Raises DatasetError, with the message's number, if it does not parse."""
        try:
            return self._types.deserialize_ros1(data, kind)
        except Exception as error:  # the generated deserialisers raise whatever the bytes lead to
            raise DatasetError(f"a message of '{topic}' does not parse ({error})", self.path, frame=index) from None

    def at(self, connections: list[Any], stamp: int, nth: int) -> bytes:
        """The ``nth`` message received at exactly ``stamp``."""
        with self._lock, explained_bag_errors(self.path):
            for k, (_, _, data) in enumerate(self._reader.messages(connections, start=stamp, stop=stamp + 1)):
                if k == nth:
                    return bytes(data)
        raise DatasetError("a message listed in the index is not there", self.path)


def _bounded(decompress: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """`rosbags`' decompressor with a limit of MAX_CHUNK_BYTES, because a few kilobytes may unpack to gigabytes."""
    from rosbags.rosbag1.reader import bz2_decompress, lz4_decompress

    if decompress not in (bz2_decompress, lz4_decompress):
        return decompress

    def unpack(data: bytes) -> bytes:
        stream: Any
        if decompress is bz2_decompress:
            stream = bz2.BZ2Decompressor()
        else:
            from lz4.frame import LZ4FrameDecompressor

            stream = LZ4FrameDecompressor()
        out: bytes = stream.decompress(data, MAX_CHUNK_BYTES)
        if not stream.eof:
            limit = f"more than {MAX_CHUNK_BYTES >> 20} MiB" if len(out) >= MAX_CHUNK_BYTES else "an incomplete stream"
            raise ValueError(f"a compressed chunk unpacks to {limit}")
        return out

    return unpack


def parse_image_header(data: bytes | memoryview, path: Path, frame: int) -> ImageHeader:
    """The header of a serialised sensor_msgs/Image. Raises DatasetError if inconsistent or of unknown encoding."""
    try:
        _, secs, nsecs, n = struct.unpack_from("<IIII", data, 0)
        at = 16 + n
        height, width, n = struct.unpack_from("<III", data, at)
        encoding = bytes(data[at + 12 : at + 12 + n]).decode("ascii", "replace")
        at += 12 + n
        _, step, length = struct.unpack_from("<BII", data, at)
        offset = at + 9
    except struct.error:
        raise DatasetError("the image message is truncated", path, frame=frame) from None
    if encoding not in ENCODINGS:
        raise DatasetError(f"the image has encoding '{encoding}'; {', '.join(ENCODINGS)} are read", path, frame=frame)
    check_limits(width, height, path, frame)
    row = width * ENCODINGS[encoding]
    if not row <= step <= 4 * MAX_SIDE or length < step * (height - 1) + row:
        raise DatasetError(f"a {width}x{height} {encoding} image cannot have {length} bytes", path, frame=frame)
    if offset + length > len(data):
        raise DatasetError("the image message is truncated", path, frame=frame)
    return ImageHeader(secs + 1e-9 * nsecs, width, height, encoding, step, offset, length)


def decode_image_message(data: bytes, path: Path, frame: int) -> NDArray[np.uint8]:
    """The image, (H, W) grey or (H, W, 3) RGB uint8, of a serialised sensor_msgs/Image."""
    header = parse_image_header(data, path, frame)
    channels = ENCODINGS[header.encoding]
    pixels = np.frombuffer(data, np.uint8, header.length, header.offset)
    padded = np.zeros(header.step * header.height, np.uint8)
    padded[: min(len(pixels), len(padded))] = pixels[: len(padded)]
    image = padded.reshape(header.height, header.step)[:, : header.width * channels]
    if channels == 1:
        return np.ascontiguousarray(image)
    image = image.reshape(header.height, header.width, 3)
    return np.ascontiguousarray(image[..., ::-1] if header.encoding == "bgr8" else image)

"""Bags as files: topics and serialised messages of ROS 1 bags and of ROS 2's (SQLite, MCAP, folders of either).

What a file is, is found out from its first bytes. Built on the pure-Python `rosbags` package. Messages are parsed with
its own definitions of ROS's standard types, whatever definitions the bag brings.
"""

from __future__ import annotations

import bz2
import struct
import tempfile
import threading
import urllib.parse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from os import fsencode
from pathlib import Path
from typing import Any, NamedTuple

from panobench.datasets.bags.layout import bag_kind, packed_storage, storage_files
from panobench.errors import DatasetError
from panobench.writing import writing

#: A compressed chunk that unpacks to more bytes is refused; recorders write chunks of a few megabytes.
MAX_CHUNK_BYTES = 256 << 20
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Place(NamedTuple):
    """Where a message is: the file of the bag, its receive time in ns, and its rank among those of that time."""

    file: int
    received: int
    rank: int


class Record(NamedTuple):
    """A serialised message."""

    topic: str
    kind: str
    place: Place
    data: bytes


@dataclass(frozen=True)
class Topic:
    """kind: the type of its messages, "mixed types" if there are several; count: how many there are."""

    kind: str
    count: int


@contextmanager
def explained_bag_errors(path: Path) -> Iterator[None]:
    """Turn what `rosbags` and what it is built on raise for a damaged file into a DatasetError."""
    import apsw
    from rosbags.rosbag1 import ReaderError as ReaderError1
    from rosbags.rosbag2 import ReaderError as ReaderError2
    from rosbags.rosbag2.storage_mcap import zstd  # of the standard library from Python 3.14 on

    try:
        yield
    except (ReaderError1, ReaderError2) as error:
        raise DatasetError(_hint(" ".join(str(a) for a in error.args)), path) from None
    except (struct.error, RuntimeError, AssertionError, LookupError, ValueError, TypeError, EOFError) as error:
        raise DatasetError(f"the bag is truncated or damaged ({_first_line(error)})", path) from None
    except (apsw.Error, zstd.ZstdError) as error:
        raise DatasetError(f"the bag is truncated or damaged ({_first_line(error)})", path) from None
    except (MemoryError, OverflowError):
        raise DatasetError("the bag is damaged: a record claims more memory than there is", path) from None
    except OSError as error:
        raise DatasetError(f"the bag cannot be read ({error.strerror or error})", path) from error


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _hint(reason: str) -> str:
    if "not indexed" in reason:
        return "the bag has no index (its recording was cut off); run `rosbag reindex` on a copy first"
    if "index looks damaged" in reason:
        return "the bag is truncated or damaged: its index cannot be read; run `rosbag reindex` on a copy first"
    if "end magic" in reason or "MCAP footer" in reason:
        return "the bag is truncated or damaged: it has no footer (its recording was cut off); run `mcap recover` on it"
    if "not ros2" in reason:
        return "this MCAP file is not of ROS 2; its messages are not read"
    return f"the bag is truncated or damaged ({' '.join(reason.split())[:200]})"


class BagFile:
    """One bag, open for reading: a file, or a folder of ROS 2. Random access by message; thread-safe."""

    def __init__(self, path: Path) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self.kind = bag_kind(path)
        self.files = storage_files(path)
        self._lock = threading.RLock()
        self._unpacked: tempfile.TemporaryDirectory[str] | None = None
        self._types = get_typestore(Stores.ROS1_NOETIC if self.kind == "ROS 1" else Stores.ROS2_HUMBLE)
        if self.kind == "ROS 1":
            self._types.register(_transforms_of_ros1())
        with explained_bag_errors(path):
            self._readers = [self._open(file) for file in self.files]
        self._cursor: _Cursor | None = None
        self.topics: dict[str, Topic] = {}
        for connection in (c for reader in self._readers for c in reader.connections):
            if not isinstance(connection.topic, str) or not isinstance(connection.msgtype, str):  # SQLite has any type
                raise DatasetError("the bag is damaged: a topic has no name or type", path)
            have = self.topics.get(connection.topic, Topic(connection.msgtype, 0))
            kind = have.kind if have.kind == connection.msgtype else "mixed types"
            self.topics[connection.topic] = Topic(kind, have.count + int(connection.msgcount))

    def _open(self, path: Path) -> Any:
        """A reader of `rosbags`, open."""
        if packed_storage(path):
            path = self._unpack(path)
        kind = bag_kind(path)
        reader: Any
        if kind == "ROS 1":
            from rosbags.rosbag1 import Reader

            reader = Reader(path)
        elif kind == "ROS 2, SQLite":
            from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

            # The reader makes a URI of the path, in which "?", "#" and "%" mean something.
            reader = Sqlite3Reader(Path(urllib.parse.quote(fsencode(path.absolute()))))
        else:
            from rosbags.rosbag2.storage_mcap import McapReader

            _bound_mcap()
            reader = McapReader(path)
        reader.open()
        for at, chunk in getattr(reader, "chunks", {}).items() if kind == "ROS 1" else ():
            reader.chunks[at] = chunk._replace(decompressor=_bounded(chunk.decompressor))
        return reader

    def _unpack(self, path: Path) -> Path:
        """A storage file that was compressed as a whole, unpacked for as long as the bag is open."""
        import shutil

        self._unpacked = self._unpacked or tempfile.TemporaryDirectory(prefix="panobench-bag-")
        target = Path(self._unpacked.name) / path.stem
        room = int(0.9 * shutil.disk_usage(target.parent).free)
        with open_zstd(path) as packed, writing(target), target.open("wb") as out:
            while block := packed.read(1 << 20):
                room -= len(block)
                if room < 0:
                    raise DatasetError(f"there is no room to unpack it in {target.parent}; set TMPDIR elsewhere", path)
                out.write(block)
        return target

    def describe_topics(self) -> str:
        """ "topic (type, n messages)" for all topics, for messages."""
        if not self.topics:
            return "the bag has no topic"
        return "it has: " + ", ".join(f"{name} ({t.kind}, {t.count})" for name, t in sorted(self.topics.items()))

    def need(self, topic: str, kinds: tuple[str, ...]) -> None:
        """Raises DatasetError, listing the topics, if ``topic`` is missing or of another type than ``kinds``."""
        if topic not in self.topics:
            raise DatasetError(f"the bag has no topic '{topic}'; {self.describe_topics()}", self.path)
        found = self.topics[topic].kind
        if found not in kinds:
            raise DatasetError(
                f"topic '{topic}' has messages of type {found}, expected {' or '.join(kinds)}", self.path
            )

    def records(self, topics: set[str]) -> Iterator[Record]:
        """All messages of some topics, each file's in order of receive time, reading it once."""
        with self._lock, explained_bag_errors(self.path):
            self._cursor = None
            for number in range(len(self._readers)):
                yield from self._from(number, topics, None)

    def _from(self, number: int, topics: set[str], start: int | None) -> Iterator[Record]:
        reader = self._readers[number]
        connections = [c for c in reader.connections if c.topic in topics]
        if not connections:
            return
        ranks: dict[str, tuple[int, int]] = {}
        for connection, received, data in reader.messages(connections, start=start):
            before, rank = ranks.get(connection.topic, (None, -1))
            rank = rank + 1 if before == received else 0
            ranks[connection.topic] = (received, rank)
            place = Place(number, int(received), rank)
            yield Record(connection.topic, connection.msgtype, place, _message(data))

    def at(self, topic: str, place: Place) -> Record:
        """One message. Those that follow each other are read without seeking."""
        with self._lock, explained_bag_errors(self.path):
            cursor = self._cursor
            if cursor is None or cursor.topic != topic or not cursor.reaches(place):
                cursor = _Cursor(topic, place, self._from(place.file, {topic}, place.received))
            self._cursor = None  # whatever goes wrong, the next message is sought anew
            for record in cursor.records:
                if record.place == place:
                    self._cursor = cursor._replace(place=place)
                    return record
                if record.place > place:
                    break
        raise DatasetError("a message listed in the index is not there", self.path)

    def parse(self, record: Record, index: int) -> Any:
        """A message as an object. Raises DatasetError, with the message's number, if it does not parse."""
        deserialize = self._types.deserialize_ros1 if self.kind == "ROS 1" else self._types.deserialize_cdr
        try:
            return deserialize(record.data, record.kind)
        except Exception as error:  # the generated deserialisers raise whatever the bytes lead to
            reason = _first_line(error)
            raise DatasetError(
                f"a message of '{record.topic}' does not parse ({reason})", self.path, frame=index
            ) from None


class _Cursor(NamedTuple):
    """Messages from ``place`` on; it is the last one that was delivered."""

    topic: str
    place: Place
    records: Iterator[Record]

    def reaches(self, place: Place) -> bool:
        """Whether ``place`` is so little ahead that reading on is better than seeking: two seconds."""
        ahead = place.received - self.place.received
        return place.file == self.place.file and place > self.place and ahead < 2_000_000_000


@lru_cache(maxsize=1)
def _transforms_of_ros1() -> Any:
    """Types that `rosbags` does not bring for ROS 1: tf2's message, and tf's of the same content."""
    from rosbags.typesys import get_types_from_msg

    names = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
    definition = "geometry_msgs/TransformStamped[] transforms"
    return {k: v for name in names for k, v in get_types_from_msg(definition, name).items()}


def _message(data: Any) -> bytes:
    """The message's bytes; ROS 2 may have compressed each of its own. CDR begins with 0, 0 or 1."""
    return unpacked_zstd(bytes(data)) if data[:4] == _ZSTD_MAGIC else bytes(data)


def open_zstd(path: Path) -> Any:
    from rosbags.rosbag2.storage_mcap import zstd

    return zstd.open(path, "rb")


def unpacked_zstd(data: bytes) -> bytes:
    """Decompressed, at most MAX_CHUNK_BYTES. Raises ValueError."""
    from rosbags.rosbag2.storage_mcap import zstd

    stream = zstd.ZstdDecompressor()
    return _all_of(stream, stream.decompress(data, MAX_CHUNK_BYTES))


def _all_of(stream: Any, out: bytes) -> bytes:
    if not stream.eof:
        limit = f"more than {MAX_CHUNK_BYTES >> 20} MiB" if len(out) >= MAX_CHUNK_BYTES else "an incomplete stream"
        raise ValueError(f"a compressed chunk unpacks to {limit}")
    return out


def _bounded(decompress: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """`rosbags`' decompressor with a limit of MAX_CHUNK_BYTES, because a few kilobytes may unpack to gigabytes."""
    from rosbags.rosbag1.reader import bz2_decompress, lz4_decompress

    if decompress is bz2_decompress:
        return _bz2
    return _lz4 if decompress is lz4_decompress else decompress


def _bz2(data: bytes) -> bytes:
    stream = bz2.BZ2Decompressor()
    return _all_of(stream, stream.decompress(data, MAX_CHUNK_BYTES))


def _lz4(data: bytes) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    stream: Any = LZ4FrameDecompressor()
    return _all_of(stream, stream.decompress(data, MAX_CHUNK_BYTES))


def _bound_mcap() -> None:
    """The same limit for MCAP's chunks, whose reader takes its decompressors from a table of its module."""
    from rosbags.rosbag2 import storage_mcap

    storage_mcap.DECOMPRESSORS["zstd"] = lambda data, _: unpacked_zstd(data)
    storage_mcap.DECOMPRESSORS["lz4"] = lambda data, _: _lz4(data)

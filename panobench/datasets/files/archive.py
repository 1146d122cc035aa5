"""Archives (zip, tar, compressed or not) as folders: unpacked once into the cache, whole or not at all.

Only plain files inside the archive's own folder are unpacked, and no more than the disk has room for.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from panobench.errors import DatasetError
from panobench.rooms.cache import cache_root
from panobench.writing import writing

#: How the names of archives that are read end.
SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
#: More files, or bytes for each byte of the archive, are no recording.
MAX_FILES, MAX_RATIO = 1_000_000, 1000
_SET_CACHE = "set PANOBENCH_CACHE to a folder that can be"


def is_archive(path: Path) -> bool:
    """By its name."""
    return path.name.lower().endswith(SUFFIXES) and path.is_file()


def unpack_into(path: Path, folder: Path) -> list[str]:
    """The archive's files below ``folder``, which may have others; each is there whole or not. The top names in it.

    Raises as ``unpacked`` does.
    """
    part = folder / f".{path.name}.{os.getpid()}.part"
    try:
        _extract(path, part, "make room, or choose another folder")
        for file in sorted(p for p in part.rglob("*") if p.is_file()):
            place = folder / file.relative_to(part)
            with writing(place):
                place.parent.mkdir(parents=True, exist_ok=True)
                file.replace(place)
        return sorted(p.name for p in part.iterdir())
    finally:
        shutil.rmtree(part, ignore_errors=True)


def unpacked(path: Path) -> Path:
    """The archive's content as a folder in the cache, below its single top folder if it has one.

    Raises DatasetError for an archive that is damaged, encrypted, too large or unsafe, OutputError for a full disk.
    """
    about = path.stat()
    key = hashlib.sha256(f"{os.path.realpath(path)}\0{about.st_size}\0{about.st_mtime_ns}".encode(errors="replace"))
    target = cache_root() / "archives" / f"{path.name.split('.')[0][:40]}-{key.hexdigest()[:16]}"
    if not target.is_dir():
        _unpack(path, target)
    inside = list(target.iterdir())
    visible = [p for p in inside if not p.name.startswith(".") and p.name != "__MACOSX"]
    return visible[0] if len(visible) == 1 and visible[0].is_dir() else target


def _unpack(path: Path, target: Path) -> None:
    part = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        _extract(path, part, "unpack it elsewhere, or set PANOBENCH_CACHE to another disk")
        with writing(target, denied=_SET_CACHE):
            try:
                part.rename(target)
            except OSError:
                if not target.is_dir():  # another process was faster
                    raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _extract(path: Path, part: Path, without_room: str) -> None:
    """Everything in the archive below ``part``, a new folder. without_room: what to do when the disk is too small."""
    with writing(part.parent, denied=_SET_CACHE):
        part.parent.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(part.parent).free
        size = path.stat().st_size
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
    total = 0
    try:
        for number, (name, length, file) in enumerate(_members(path)):
            total += length
            if number >= MAX_FILES or total > MAX_RATIO * size + (1 << 20):
                raise DatasetError("the archive unpacks to more than a recording would", path)
            if total > 0.9 * free:
                raise DatasetError(
                    f"the archive needs over {total >> 20} MiB in {part.parent}, which has {free >> 20} MiB; "
                    f"{without_room}",
                    path,
                )
            _write(part, name, length, file, path)
    except _DAMAGE as error:
        raise DatasetError(f"the archive cannot be unpacked ({' '.join(str(error).split())[:200]})", path) from None


#: What reading a damaged archive raises; what writing raises is an OutputError.
_DAMAGE = (
    zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, EOFError, NotImplementedError, RuntimeError,
    ValueError, LookupError, OverflowError, MemoryError, OSError,
)  # fmt: skip


def _members(path: Path) -> Iterator[tuple[str, int, IO[bytes]]]:
    """Name, size and open file of each plain file."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            for info in archive.infolist():
                if not info.is_dir():
                    with archive.open(info) as file:
                        yield info.filename, info.file_size, file
        return
    with tarfile.open(path) as archive:
        for member in archive:
            if member.isfile():
                opened = archive.extractfile(member)
                if opened is not None:
                    with opened:
                        yield member.name, member.size, opened


def _write(part: Path, name: str, length: int, file: IO[bytes], path: Path) -> None:
    relative = PurePosixPath(name.replace("\\", "/"))
    if (
        relative.is_absolute()
        or ".." in relative.parts
        or "\0" in name
        or not relative.parts
        or ":" in relative.parts[0]
    ):
        raise DatasetError(f"the archive has a file outside of itself: '{name[:200]}'", path)
    if relative.name.startswith("._") or "__MACOSX" in relative.parts:
        return
    place = part.joinpath(*relative.parts)
    data_left = length
    with writing(place, denied=_SET_CACHE):
        place.parent.mkdir(parents=True, exist_ok=True)
        with place.open("wb") as out:
            while data_left > 0 and (block := file.read(min(1 << 20, data_left))):
                out.write(block)
                data_left -= len(block)
    if data_left:
        raise DatasetError(f"the archive is cut short in '{name[:200]}'", path)

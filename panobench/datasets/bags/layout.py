"""Which files and folders are bags, by their first bytes, and which files belong to one."""

from __future__ import annotations

import re
from pathlib import Path

from panobench.datasets.files.listing import children
from panobench.datasets.files.natural import natural_paths
from panobench.errors import DatasetError

#: How bags' names end. ROS 2's may be compressed as a whole.
BAG_SUFFIXES = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
METADATA = "metadata.yaml"
_MAGIC = {
    b"#ROSBAG V2.0": "ROS 1",
    b"SQLite format 3\0": "ROS 2, SQLite",
    b"\x89MCAP0\r\n": "ROS 2, MCAP",
    b"\x28\xb5\x2f\xfd": "ROS 2",
}
_ROS2_METADATA = "rosbag2_bagfile_information"


def bag_kind(path: Path) -> str:
    """ "ROS 1", "ROS 2, SQLite" and so on. Raises DatasetError for a file that is no bag."""
    if path.is_dir():
        return "ROS 2"
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise DatasetError(f"the bag cannot be read ({error.strerror})", path) from error
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    if head.startswith(b"#ROSBAG"):
        raise DatasetError("this bag is older than ROS 1's version 2.0; `rosbag fix` makes one of it", path)
    raise DatasetError("this is not a bag of ROS 1 (version 2.0) or ROS 2 (SQLite, MCAP)", path)


def packed_storage(path: Path) -> bool:
    """Whether a storage file was compressed as a whole."""
    return path.is_file() and path.name.lower().endswith(".zstd")


def is_bag_name(name: str) -> bool:
    return name.lower().endswith(BAG_SUFFIXES)


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is one bag of ROS 2: by its metadata, or, if a recording was cut off, by its files' names."""
    if not path.is_dir():
        return False
    metadata = path / METADATA
    if metadata.is_file():
        with metadata.open("rb") as file:
            if _ROS2_METADATA.encode() in file.read(1 << 12):
                return True
    return bool(_parts(path))


def _parts(folder: Path) -> list[Path]:
    """``NAME_0.db3``, ``NAME_1.db3`` ... in a folder called NAME."""
    name = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(db3|mcap)(\.zstd)?", re.IGNORECASE)
    return natural_paths(p for p in children(folder) if name.fullmatch(p.name) and p.is_file())


def storage_files(path: Path) -> list[Path]:
    """The files of a bag, in order. Raises DatasetError if a folder's metadata name one that is missing."""
    if path.is_file():
        return [path]
    there = _parts(path) or [p for p in children(path) if is_bag_name(p.name) and p.suffix != ".bag" and p.is_file()]
    named = [path / name for name in _named(path / METADATA)]
    missing = [file.name for file in named if not _is_file(file)]
    if named and not missing:
        return named
    if len(there) < len(named):  # otherwise they were renamed
        raise DatasetError(f"the bag is incomplete: '{missing[0]}' is missing, which {METADATA} names", path)
    if not there:
        raise DatasetError("no .db3 and no .mcap file here", path)
    return natural_paths(there)


def _is_file(path: Path) -> bool:
    """False also for a name that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _named(metadata: Path) -> list[str]:
    """File names in metadata.yaml; [] if it has none that can be read: the files themselves say more."""
    from panobench.reading import parse_yaml, read_text

    if not metadata.is_file():
        return []
    try:
        values = parse_yaml(read_text(metadata, "the metadata", error=DatasetError), metadata, DatasetError)
        listed = values[_ROS2_METADATA]["relative_file_paths"]
    except (DatasetError, KeyError, TypeError):
        return []
    return [Path(str(name)).name for name in listed] if isinstance(listed, list) else []


def find_bags(root: Path, levels: int = 2) -> dict[str, Path]:
    """Name -> bag, of ``root`` itself or of what is in it and its folders, in natural order."""
    if root.is_file() or is_bag_folder(root):
        return {bag_name(root): root}
    bags = [p for p in children(root) if (is_bag_folder(p) if p.is_dir() else is_bag_name(p.name))]
    names = [bag_name(path) for path in bags]
    found = {name if names.count(name) == 1 else path.name: path for name, path in zip(names, bags)}
    for child in children(root):
        if child.is_dir() and child not in bags and levels > 0:
            found |= {f"{child.name}/{name}": path for name, path in find_bags(child, levels - 1).items()}
    return found


def bag_name(path: Path) -> str:
    """What a bag is called: without the endings of a file."""
    if path.is_dir():
        return path.resolve().name
    return re.sub(r"\.(bag|db3|mcap)(\.zstd)?$", "", path.name, flags=re.IGNORECASE) or path.name

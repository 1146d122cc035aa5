"""SHA-256 of files, for run.json and for resuming a conversion."""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

#: Larger sequences are identified by their names and sizes and the content of the first and last file.
WHOLE_LIMIT = 512 << 20


def sha256_file(path: Path) -> str:
    """Hex SHA-256 of a file's content."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def known_sha256(path: Path) -> str:
    """As ``sha256_file``, but a file is read again only if its size or time of change differs."""
    about = path.stat()
    return _known(path, about.st_size, about.st_mtime_ns, about.st_ino)


@lru_cache(maxsize=100_000)
def _known(path: Path, size: int, changed: int, inode: int) -> str:
    return sha256_file(path)


def sha256_bytes(data: bytes) -> str:
    """Hex SHA-256 of bytes."""
    return hashlib.sha256(data).hexdigest()


def files_provenance(files: list[Path]) -> dict[str, Any]:
    """One checksum over all files, in the order given: {"files", "bytes", "sha256", "sha256_of"}.

    Over 512 MiB it covers the name and size of every file, and the content of the first and the last only;
    "sha256_of" says which.
    """
    sizes = [path.stat().st_size for path in files]
    whole = sum(sizes) <= WHOLE_LIMIT
    digest = hashlib.sha256()
    for i, (path, size) in enumerate(zip(files, sizes)):
        digest.update(os.fsencode(path.name) + f"\0{size}\0".encode())
        if whole or i in (0, len(files) - 1):
            digest.update(known_sha256(path).encode())
    return {
        "files": len(files),
        "bytes": sum(sizes),
        "sha256": digest.hexdigest(),
        "sha256_of": "names, sizes and contents" if whole else "names and sizes, and the first and last file",
    }

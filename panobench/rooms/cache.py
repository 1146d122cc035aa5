"""Rendered rooms on disk. A folder is keyed by all it depends on, complete or absent, and shared between processes."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from panobench.writing import writing

#: Goes up when the pictures change on purpose; part of every provenance record.
GENERATOR_VERSION = 1


def cache_root() -> Path:
    """``$PANOBENCH_CACHE``, else ``$XDG_CACHE_HOME/panobench``, else ``~/.cache/panobench``."""
    own = os.environ.get("PANOBENCH_CACHE")
    if own:
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "panobench"


@lru_cache(maxsize=1)
def source_digest() -> str:
    """Digest of the generator's own source: a changed generator never serves the pictures of the old one."""
    digest = hashlib.sha256(str(GENERATOR_VERSION).encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def key_of(values: dict[str, Any]) -> str:
    """Short digest of plain values and of the generator's source."""
    text = json.dumps(values, sort_keys=True, default=str) + source_digest()
    return hashlib.sha256(text.encode()).hexdigest()[:20]


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an advisory lock on ``path`` where the platform has one; ``publish`` is correct without it, too."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "ab") as handle:
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX)
        except (ImportError, OSError):
            pass
        yield


def publish(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make ``folder`` by ``fill(temporary folder)`` and a rename; do nothing if it exists.

    If two processes do so at once, the second waits for the lock; without locks the later copy is discarded.
    Raises OutputError when the cache cannot be written.
    """
    if folder.is_dir():
        return
    lock = folder.with_name(folder.name + ".lock")
    with writing(folder, denied="set PANOBENCH_CACHE to a folder that can be"), locked(lock):
        if folder.is_dir():
            return
        temporary = folder.with_name(f".{folder.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}")
        temporary.mkdir(parents=True)
        try:
            fill(temporary)
            try:
                os.rename(temporary, folder)
            except OSError:
                if not folder.is_dir():
                    raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

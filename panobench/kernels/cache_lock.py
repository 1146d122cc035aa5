"""Locks around Numba's cache of compiled kernels, which several processes may fill at once.

Numba writes each file by a rename, but reads an index, chooses the next free name and writes both in three steps: two
processes that save two variants of one function at once may leave an index that names the other's code.
"""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_LOCK = "panobench-kernels.lock"


@contextlib.contextmanager
def exclusive(folder: Path, name: str = _LOCK) -> Iterator[None]:
    """Hold the folder's lock; goes on without one where the system has none (a network's file system, Windows)."""
    with contextlib.ExitStack() as stack:
        try:
            import fcntl

            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        except (ImportError, OSError):
            pass
        yield


@functools.cache
def guard_cache() -> None:
    """Let this process and others that do so save one kernel at a time. Does nothing to a Numba it does not know."""
    try:
        from numba.core.caching import IndexDataCacheFile

        save = IndexDataCacheFile.save
    except (ImportError, AttributeError):
        return

    @functools.wraps(save)
    def locked(self: Any, key: Any, data: Any) -> None:
        index = Path(self._index_path)
        with exclusive(index.parent, f".{_LOCK}.save"):
            save(self, key, data)

    IndexDataCacheFile.save = locked  # type: ignore[method-assign]

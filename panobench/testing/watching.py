"""Watch which files Python code opens while a method runs, by the interpreter's audit events.

This sees files opened through Python's ``open``, ``os`` and ``numpy``, not those that C++ code opens by itself.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = {"os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.truncate", "os.symlink", "os.link"}


@dataclass
class Watched:
    """Absolute paths read and written while watching, in order."""

    read: list[Path] = field(default_factory=list)
    written: list[Path] = field(default_factory=list)

    def _note(self, event: str, args: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = args
            if isinstance(path, int) or path is None:
                return
            writes = isinstance(flags, int) and bool(flags & _WRITE_FLAGS)
            (self.written if writes else self.read).append(_absolute(path))
        elif event in _CHANGES:
            self.written += [_absolute(p) for p in args[:2] if isinstance(p, (str, bytes, os.PathLike))]

    def written_outside(self, *allowed: Path) -> list[Path]:
        """Written paths below none of ``allowed``; devices and Python's compiled-code caches are left out."""
        roots = [Path(os.path.realpath(a)) for a in allowed]
        return [
            p
            for p in dict.fromkeys(self.written)
            if "__pycache__" not in p.parts
            and not str(p).startswith(("/dev/", "/proc/"))
            and not any(Path(os.path.realpath(p)).is_relative_to(r) for r in roots)
        ]


def _absolute(path: Any) -> Path:
    return Path(os.path.abspath(os.fsdecode(path)))


_lock = threading.Lock()
_current: list[Watched] = []
_installed = False


def _hook(event: str, args: tuple[Any, ...]) -> None:
    if _current and (event == "open" or event in _CHANGES):
        try:
            _current[-1]._note(event, args)
        except Exception:  # an audit hook that raises would break the code under test
            return


@contextmanager
def watch_files() -> Iterator[Watched]:
    """Note every file that this process opens within the block. The hook stays installed, doing nothing."""
    global _installed
    with _lock:
        if not _installed:
            sys.addaudithook(_hook)
            _installed = True
    watched = Watched()
    _current.append(watched)
    try:
        yield watched
    finally:
        _current.remove(watched)

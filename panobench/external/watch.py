"""Find what a program wrote beside its work folder, where the kernel could not keep it from doing so."""

from __future__ import annotations

import os
from pathlib import Path

import psutil

MAX_ENTRIES = 20000
Listing = dict[str, tuple[int, int]]


def guarded_folders(work: Path) -> list[Path]:
    """Where strays land: the two folders above the work folder, the current one and the home folder."""
    folders = [work.parent, work.parent.parent, Path.cwd(), Path.home()]
    return list(dict.fromkeys(f.resolve() for f in folders))


def listing(folders: list[Path], work: Path) -> Listing:
    """path -> (mtime in ns, size) of the entries of ``folders``, without the work folder; folders count as size 0."""
    found: Listing = {}
    skip = str(work.resolve())
    for folder in folders:
        try:
            entries = list(os.scandir(folder))[:MAX_ENTRIES]
        except OSError:
            continue
        for entry in entries:
            path = os.path.join(os.path.realpath(folder), entry.name)
            if path == skip or skip.startswith(path + os.sep):
                continue
            try:
                info = entry.stat(follow_symlinks=False)
            except OSError:
                continue
            found[path] = (0, 0) if entry.is_dir(follow_symlinks=False) else (info.st_mtime_ns, info.st_size)
    return found


def strays(before: Listing, after: Listing) -> list[Path]:
    """What is new or changed, except files that this process itself has open (its logs)."""
    changed = [path for path, state in after.items() if before.get(path) != state]
    if not changed:
        return []
    own = {os.path.realpath(f.path) for f in psutil.Process().open_files()}
    return [Path(path) for path in sorted(changed) if path not in own]

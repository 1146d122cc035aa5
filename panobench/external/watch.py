"""Find what a program wrote outside its work folder, for kernels that cannot confine it (see ``confine``)."""

from __future__ import annotations

import os
from pathlib import Path

import psutil

MAX_ENTRIES = 20000
#: path -> (time of modification in ns, size)
Listing = dict[str, tuple[int, int]]


def watched_folders(work: Path) -> list[Path]:
    """Folders that programs tend to write to: the two above the work folder, the current and the home folder."""
    folders = [work.parent, work.parent.parent, Path.cwd(), Path.home()]
    return list(dict.fromkeys(f.resolve() for f in folders))


def list_files(folders: list[Path], work: Path) -> Listing:
    """The entries of ``folders`` without the work folder. Folders among them are listed with time and size 0."""
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


def written_outside(before: Listing, after: Listing) -> list[Path]:
    """The files that are new or changed, except those that this process itself has open (its logs)."""
    changed = [path for path, state in after.items() if before.get(path) != state]
    if not changed:
        return []
    own = {os.path.realpath(f.path) for f in psutil.Process().open_files()}
    return [Path(path) for path in sorted(changed) if path not in own]

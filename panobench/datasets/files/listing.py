"""What a folder holds for a dataset: its files and folders without what operating systems leave in between."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from panobench.datasets.files.natural import natural_paths
from panobench.errors import DatasetError

#: Folders of operating systems and of network storage. macOS's hold a shadow (``._NAME``) of every file, Synology's
#: thumbnails of every picture, the others what was deleted.
_OF_SYSTEMS = {
    *("__MACOSX", "@eaDir", "#recycle", "@Recycle", "$RECYCLE.BIN", "System Volume Information", "lost+found"),
}


def visible(path: Path) -> bool:
    """Neither hidden (``.DS_Store``, macOS's ``._NAME``) nor a folder of the system's own."""
    return not path.name.startswith(".") and path.name not in _OF_SYSTEMS


def children(folder: Path) -> list[Path]:
    """The visible files and folders directly in ``folder``, in natural order. Raises DatasetError if it is missing."""
    try:
        return natural_paths(p for p in folder.iterdir() if visible(p))
    except OSError as error:
        raise DatasetError(f"the folder cannot be listed: {error.strerror}", folder) from None


def one_of_each(images: list[Path]) -> list[Path]:
    """The same list. Raises DatasetError where two differ in their ending alone: one frame would come twice."""
    seen: dict[str, Path] = {}
    for path in images:
        other = seen.setdefault(path.stem, path)
        if other is not path:
            raise DatasetError(f"{other.name} and {path.name} are the same frame twice? keep one of them", path.parent)
    return images


def by_stem(files: Iterable[Path]) -> dict[str, Path]:
    """Name -> file: the name without its ending, or with it where another file would have the same."""
    files = list(files)
    stems = [path.stem for path in files]
    return {path.stem if stems.count(path.stem) == 1 else path.name: path for path in files}

"""Write files. What goes wrong on the disk becomes an OutputError that tells the user what to do."""

from __future__ import annotations

import enum
import errno
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypedDict

from panobench.errors import OutputError


class TextOptions(TypedDict):
    """How text is written."""

    encoding: str
    errors: str


#: Files' names may hold bytes that are not UTF-8; in texts for people they are escaped.
TEXT: TextOptions = {"encoding": "utf-8", "errors": "backslashreplace"}
#: What to do about a full disk, unless a command knows better.
AGAIN = "free some space and run the same command again"


def is_disk_full(error: BaseException | None) -> bool:
    """Whether an error, or what caused it, is that the disk or the quota is full."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False


def disk_full(path: Path, again: str = AGAIN) -> OutputError:
    """The error to raise when ``path`` did not fit."""
    return OutputError(f"{path}: the disk is full; {again}")


@contextmanager
def writing(path: Path, again: str = AGAIN, denied: str = "") -> Iterator[None]:
    """Turn the block's OSErrors into an OutputError about ``path``. Put nothing but writing into the block.

    again: what to do about a full disk. denied: what to do when it cannot be written for another reason.
    """
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise disk_full(path, again) from error
        hint = f"; {denied}" if denied else ""
        raise OutputError(f"{path}: cannot be written ({error.strerror or error}){hint}") from error


def json_ready(value: Any) -> Any:
    """A copy that JSON can hold: enums by value, arrays and tuples as lists, what JSON has no word for as text.

    Numbers that are not finite become None.
    """
    if isinstance(value, enum.Enum):
        return json_ready(value.value)
    if isinstance(value, Mapping):
        return {str(k): json_ready(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [json_ready(v) for v in value]
    if hasattr(value, "tolist"):
        return json_ready(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def write_whole(path: Path, data: bytes | str) -> None:
    """Write a file beside its place and rename it, so that a reader never sees half of it. Makes folders as needed.

    A device or pipe (/dev/stdout) is written to, never replaced. Raises OutputError.
    """
    content = data.encode(**TEXT) if isinstance(data, str) else data
    place = Path(os.path.realpath(path))  # the target of a link is written, and the link stays
    part = place.with_name(f".{place.name}.{os.getpid()}.part")
    with writing(path):
        if place.exists() and not place.is_file():
            place.write_bytes(content)
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(content)
            part.replace(place)
        except BaseException:
            part.unlink(missing_ok=True)
            raise

"""Where compiled kernels are kept: as Numba chooses, or in a temporary folder where it can write to none of its places.

Numba takes NUMBA_CACHE_DIR, else ``__pycache__`` beside the code, else the user's cache folder, and gives up where none
can be written (a package of root's, a user without a home, a read-only container). ``prepare`` runs when panobench is
imported, before Numba is, and imports nothing heavy.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

from panobench.errors import UnavailableError

VARIABLE = "NUMBA_CACHE_DIR"
#: What was decided: a line for the user where kernels are not kept, None where all is well.
_note: str | None = None
_nowhere = False


def prepare() -> None:
    """Name a temporary folder in NUMBA_CACHE_DIR if Numba would find no place that can be written."""
    global _note, _nowhere
    given = os.environ.get(VARIABLE)
    package = Path(__file__).parent
    places = [*([Path(given)] if given else []), package / "__pycache__", _user_cache()]
    if any(_writable(place) for place in places):
        return
    wrong = f"{VARIABLE}={given} cannot be written" if given else "neither the package nor the home can be written"
    folder = _temporary()
    if folder is None:
        _nowhere = True
        _note = f"{wrong}, nor can a temporary folder: set {VARIABLE} to a folder that can"
        return
    os.environ[VARIABLE] = str(folder)
    numba = sys.modules.get("numba")
    if numba is not None:
        numba.config.CACHE_DIR = str(folder)
    _note = f"{wrong}: compiled kernels go to {folder}; set {VARIABLE} to a folder that is kept"


def note() -> str | None:
    """One line about kernels that may have to be compiled again; None where they are kept."""
    return _note


def require() -> None:
    """Raises UnavailableError where kernels can be put nowhere, so that no method can run."""
    if _nowhere:
        raise UnavailableError(str(_note))


def location() -> str:
    """Where kernels are kept, for people."""
    return _note or os.environ.get(VARIABLE) or "beside the code, or in the user's cache folder"


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "numba"


def _writable(place: Path) -> bool:
    """Whether the folder can be written, or made where it is not there."""
    try:
        while not place.exists():
            if place == place.parent:
                return False
            place = place.parent
        return place.is_dir() and os.access(place, os.W_OK | os.X_OK)
    except OSError:  # a parent that cannot be looked into
        return False


def _temporary() -> Path | None:
    """A folder of this user's alone, because what is in it is executed; the same at the next run."""
    import tempfile

    try:
        folder = Path(tempfile.gettempdir()) / f"panobench-kernels-{os.geteuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        if stat.S_ISDIR(about.st_mode) and about.st_uid == os.geteuid() and not about.st_mode & 0o077:
            return folder
        return Path(tempfile.mkdtemp(prefix="panobench-kernels-"))
    except OSError:
        return None

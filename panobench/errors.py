"""Errors a user can act on. The CLI prints their message on one line and exits with code 2.

Anything that is not a ``PanobenchError`` is a bug and keeps its traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class PanobenchError(Exception):
    """Base of every error whose message tells the user what to do.

    ``run_status`` is the RunStatus value of a run that this error ended.
    """

    exit_code = 2
    run_status = "crashed"


class UsageError(PanobenchError):
    """An option or a combination of options that makes no sense."""


class UnknownNameError(UsageError):
    """The name of a plugin, sequence or option is not known; the message suggests the nearest one.

    nearest: what to suggest, if not what is spelt most nearly so. listed_by: the command that lists the known names,
    given where they are too many for one line.
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str], *, nearest: Iterable[str] | None = None, listed_by: str = ""
    ) -> None:
        known = sorted(known)
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.5) if nearest is None else list(nearest)
        hint = f"did you mean {' or '.join(repr(c) for c in close)}? " if close else ""
        choices = ", ".join(known) if known else "none"
        listing = f"`{listed_by}` lists them all" if listed_by and known else f"known: {choices}"
        super().__init__(f"unknown {kind} '{name}': {hint}{listing}")
        self.kind, self.name, self.known = kind, name, known


class InputError(PanobenchError):
    """Data cannot be used; the message names the file and, where there is one, the line or frame."""

    def __init__(
        self,
        message: str,
        path: Path | str | None = None,
        *,
        line: int | None = None,
        frame: int | str | None = None,
    ) -> None:
        where = "" if path is None else str(path)
        if line is not None:
            where += f":{line}"
        if frame is not None:
            where += f"{', ' if where else ''}frame {frame}"
        super().__init__(f"{where}: {message}" if where else message)
        self.path, self.line, self.frame = path, line, frame


class PanobenchWarning(UserWarning):
    """Work goes on, and the user should know of something; the command line prints it as one line."""


class InputWarning(PanobenchWarning):
    """Data that is used although something about it may not be as assumed; one line that says what to do."""


class CalibrationError(InputError):
    """A calibration file that does not parse or contradicts itself."""


class DatasetError(InputError):
    """A dataset or sequence that is missing, incomplete or malformed."""


class OutputError(PanobenchError):
    """A file cannot be written: the disk is full, or permission is missing. Nothing finished is lost."""


class UnsupportedError(PanobenchError):
    """A combination that the method, camera or format does not support; the message says what it does support."""

    run_status = "unsupported"


class UnavailableError(PanobenchError):
    """Something registered cannot run here; the message says in one line what is missing."""

    run_status = "unavailable"


class MethodError(PanobenchError):
    """A method broke its contract (wrong shapes, poses that are not rigid, ...)."""


class MethodTimeoutError(MethodError):
    """A method, or the program it started, took longer than its limit."""

    run_status = "timeout"

"""The viewer of `panobench run --viewer`: rerun, rerun:FILE.rrd, web, web:PORT or web:HOST:PORT."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from panobench.errors import OutputError, UnavailableError, UnknownNameError, UsageError
from panobench.plugins import registry

VIEWERS = ("rerun", "web")


@contextmanager
def viewer(option: str) -> Iterator[None]:
    """Register the viewer for as long as the context lasts.

    Raises UnknownNameError, UsageError, UnavailableError (its package is missing) or OutputError.
    """
    name, _, argument = option.partition(":")
    if name not in VIEWERS:
        raise UnknownNameError("viewer", name, VIEWERS)
    plugin = _rerun(option, argument) if name == "rerun" else _web(option, argument)
    manager = registry().manager
    manager.register(plugin, name="panobench.viewer")
    try:
        yield
    finally:
        manager.unregister(plugin)
        plugin.close()


def _rerun(option: str, argument: str) -> Any:
    file = Path(argument) if argument else None
    if file is not None and file.suffix != ".rrd":
        raise UsageError(f"--viewer {option}: the file's name must end in .rrd")
    if file is not None and not file.absolute().parent.is_dir():
        raise OutputError(f"--viewer {option}: there is no folder {file.absolute().parent}")
    if importlib.util.find_spec("rerun") is None:
        raise UnavailableError("--viewer rerun needs the Python package 'rerun-sdk': pip install 'panobench[viewer]'")
    from panobench.viewer.rerun_viewer import RerunViewer

    return RerunViewer(file)


def _web(option: str, argument: str) -> Any:
    """Only this machine can look, unless an address is named."""
    host, _, number = argument.rpartition(":")
    if number and not (number.isdecimal() and 0 < int(number) < 65536):
        raise UsageError(f"--viewer {option}: give web, web:PORT or web:HOST:PORT")
    if importlib.util.find_spec("viser") is None:
        raise UnavailableError("--viewer web needs the Python package 'viser': pip install 'panobench[web]'")
    from panobench.viewer.web_viewer import PORT, WebViewer

    return WebViewer(host or "localhost", int(number or PORT))

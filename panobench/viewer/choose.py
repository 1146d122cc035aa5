"""The viewer of `panobench run --viewer NAME[:FILE]`."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from panobench.errors import OutputError, UnavailableError, UnknownNameError, UsageError
from panobench.plugins import registry

VIEWERS = ("rerun",)


@contextmanager
def viewer(option: str) -> Iterator[None]:
    """Register the viewer for as long as the context lasts.

    Raises UnknownNameError, UsageError, UnavailableError (its package is missing) or OutputError.
    """
    name, _, argument = option.partition(":")
    if name not in VIEWERS:
        raise UnknownNameError("viewer", name, VIEWERS)
    file = Path(argument) if argument else None
    if file is not None and file.suffix != ".rrd":
        raise UsageError(f"--viewer {option}: the file's name must end in .rrd")
    if file is not None and not file.absolute().parent.is_dir():
        raise OutputError(f"--viewer {option}: there is no folder {file.absolute().parent}")
    if importlib.util.find_spec("rerun") is None:
        raise UnavailableError("--viewer rerun needs the Python package 'rerun-sdk': pip install 'panobench[viewer]'")
    from panobench.viewer.rerun_viewer import RerunViewer

    plugin = RerunViewer(file)
    manager = registry().manager
    manager.register(plugin, name="panobench.viewer")
    try:
        yield
    finally:
        manager.unregister(plugin)
        plugin.close()

"""Write a new plugin package from the templates beside this module."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from panobench.errors import OutputError, UnknownNameError, UsageError
from panobench.plugins import registry
from panobench.writing import write_whole

_WHAT = {
    "method": ("method", "a method that estimates yaw", "It estimates how far a panorama turned."),
    "camera": ("camera", "a fisheye whose radius is f theta", "It adds a camera model."),
    "dataset": ("dataset", "folders of panoramas with a times.txt", "It reads a dataset's layout."),
    "metric": ("metric", "end-point drift in percent of the path", "It adds a number to every run."),
    "depth": ("depth", "a room of assumed size", "It estimates the depth a map starts from."),
}
KINDS = tuple(_WHAT)
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


@dataclass(frozen=True)
class NewPackage:
    """What was written: the folder and its files, relative to it."""

    folder: Path
    files: list[Path]


def new_package(name: str, kind: str, parent: Path) -> NewPackage:
    """Write ``parent/panobench-NAME``. Raises UsageError for a name that cannot be used or a folder that exists."""
    if kind not in _WHAT:
        raise UnknownNameError("kind of plugin", kind, KINDS)
    name = name.removeprefix("panobench-")
    if not _NAME.fullmatch(name):
        raise UsageError(f"'{name}' is no plugin name: use lower-case letters and digits, words joined by '-'")
    if name in registry().entries.get(kind, {}):
        taken = registry().entries[kind][name].origin
        raise UsageError(f"there is a {kind} '{name}' already ({taken}); choose another name")
    folder = parent / f"panobench-{name}"
    if folder.exists():
        raise UsageError(f"{folder} exists already; choose another name or folder")
    module_file, summary, what = _WHAT[kind]
    module = name.replace("-", "_")
    values = {
        "NAME": name,
        "MODULE": module,
        "CLASS": "".join(word.capitalize() for word in name.split("-")),
        "KIND": kind,
        "SUMMARY": summary,
        "WHAT": what,
    }
    layout = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        f"src/panobench_{module}/__init__.py": f"{kind}.init",
        f"src/panobench_{module}/{module_file}.py": f"{kind}.impl",
        f"tests/test_{module}.py": f"{kind}.test",
    }
    templates = files("panobench.testing") / "templates"
    try:
        for path, template in layout.items():
            text = (templates / f"{template}.tmpl").read_text(encoding="utf-8")
            for key, value in values.items():
                text = text.replace(f"@{key}@", value)
            write_whole(folder / path, text)
    except OutputError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return NewPackage(folder, [Path(p) for p in layout])

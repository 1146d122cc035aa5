"""Find a plugin to check: an installed distribution, an entry point, or a folder with a pyproject.toml."""

from __future__ import annotations

import importlib
import importlib.metadata
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panobench.errors import UnavailableError, UnknownNameError, UsageError
from panobench.plugins import ENTRY_POINT_GROUP, Registry, load_registry
from panobench.specs import Spec

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class FoundPlugin:
    """A plugin's distribution name, its loaded entry points and the specs they registered."""

    name: str
    modules: list[Any]
    specs: list[Spec]


def find_plugin(package: str) -> FoundPlugin:
    """Load the plugin that ``package`` names. Raises UsageError or UnavailableError saying what is wrong with it."""
    folder = Path(package)
    if (folder / "pyproject.toml").is_file():
        return _from_folder(folder)
    entries = list(importlib.metadata.entry_points(group=ENTRY_POINT_GROUP))
    named = [e for e in entries if package in (e.name, e.dist.name if e.dist else None, f"panobench-{e.name}")]
    if not named:
        known = {e.dist.name for e in entries if e.dist} | {e.name for e in entries}
        raise UnknownNameError("plugin package (or folder with a pyproject.toml)", package, known)
    return _load(package, {e.name: e.value for e in named})


def _from_folder(folder: Path) -> FoundPlugin:
    path = folder / "pyproject.toml"
    try:
        project = tomllib.loads(path.read_text(encoding="utf-8")).get("project", {})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} does not parse: {error}") from error
    entries = project.get("entry-points", {}).get(ENTRY_POINT_GROUP, {})
    if not entries:
        raise UsageError(f"{path} has no entry point in group '{ENTRY_POINT_GROUP}': [project.entry-points.panobench]")
    source = folder / "src" if (folder / "src").is_dir() else folder
    sys.path.insert(0, str(source.resolve()))
    return _load(str(project.get("name", folder.name)), dict(entries))


def _load(name: str, entries: dict[str, str]) -> FoundPlugin:
    registry: Registry = load_registry(entry_points=False)
    before = {id(r) for r in registry.all()}
    modules = []
    for entry, value in entries.items():
        module, _, attribute = value.partition(":")
        try:
            plugin = importlib.import_module(module)
            modules.append(getattr(plugin, attribute) if attribute else plugin)
            registry.add_plugin(modules[-1], f"{name}:{entry}", name)
        except (Exception, SystemExit) as error:  # a plugin's import may raise anything
            reason = f"{type(error).__name__}: {error}"
            raise UnavailableError(f"plugin '{entry}' of {name} cannot be loaded: {reason}") from error
    return FoundPlugin(name, modules, [r.spec for r in registry.all() if id(r) not in before])

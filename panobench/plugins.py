"""Finding plugins and looking things up by name.

A plugin is an entry point in group "panobench" (a module or object with ``@panobench.hookimpl``
functions). One that fails to import is skipped with a warning that names it.
"""

from __future__ import annotations

import importlib.metadata
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, TypeVar

import pluggy

from panobench import hookspecs
from panobench.errors import UnknownNameError
from panobench.specs import (
    CONTRACT_VERSION,
    CameraSpec,
    DatasetSpec,
    DepthSpec,
    MaskSpec,
    MethodSpec,
    MetricSpec,
    Spec,
    StudySpec,
)

ENTRY_POINT_GROUP = "panobench"
_HOOKS: dict[type[Spec], str] = {
    CameraSpec: "register_cameras",
    DatasetSpec: "register_datasets",
    MethodSpec: "register_methods",
    DepthSpec: "register_depth_estimators",
    MaskSpec: "register_mask_estimators",
    MetricSpec: "register_metrics",
    StudySpec: "register_studies",
}
S = TypeVar("S", bound=Spec)


class PluginWarning(UserWarning):
    """A plugin could not be used and was skipped."""


@dataclass(frozen=True)
class Registered:
    """A spec and where it came from ("built-in" or "distribution version")."""

    spec: Spec
    origin: str


@dataclass
class Registry:
    """All specs by kind and name, and the pluggy manager for the lifecycle hooks."""

    manager: pluggy.PluginManager
    entries: dict[str, dict[str, Registered]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    def specs(self, kind: type[S]) -> dict[str, S]:
        """name -> spec of that kind, in registration order (built-ins first)."""
        return {n: r.spec for n, r in self.entries.get(kind.kind, {}).items()}  # type: ignore[misc]

    def get(self, kind: type[S], name: str) -> S:
        """The spec of that name. Raises UnknownNameError with the nearest name."""
        found = self.specs(kind).get(name)
        if found is None:
            raise UnknownNameError(kind.kind, name, self.specs(kind))
        return found

    def all(self) -> Iterable[Registered]:
        for by_name in self.entries.values():
            yield from by_name.values()

    def add_plugin(self, plugin: Any, name: str, origin: str) -> None:
        """Register a plugin object's hooks and the specs they return."""
        self.manager.register(plugin, name=name)
        self.manager.check_pending()
        for kind, hook in _HOOKS.items():
            implementation = getattr(plugin, hook, None)
            if implementation is None:
                continue
            for spec in implementation() or ():
                if not isinstance(spec, kind):
                    raise TypeError(f"{hook}() returned {spec!r}, which is not a {kind.__name__}")
                if isinstance(spec, MethodSpec) and not same_contract(spec.contract):
                    warnings.warn(
                        f"method '{spec.name}' of plugin {origin} is skipped: it was written for contract "
                        f"{spec.contract}, this panobench has {CONTRACT_VERSION}",
                        PluginWarning,
                        stacklevel=2,
                    )
                    continue
                by_name = self.entries.setdefault(kind.kind, {})
                if spec.name in by_name:
                    other = by_name[spec.name].origin
                    warnings.warn(
                        f"{kind.kind} '{spec.name}' of plugin {origin} is skipped: {other} has that name",
                        PluginWarning,
                        stacklevel=2,
                    )
                    continue
                by_name[spec.name] = Registered(spec, origin)


def same_contract(version: str) -> bool:
    """A plugin written for contract ``version`` works here: same first number, second not newer than ours."""
    try:
        major, minor = (int(part) for part in version.split("."))
    except ValueError:
        return False
    ours = [int(part) for part in CONTRACT_VERSION.split(".")]
    return major == ours[0] and minor <= ours[1]


def load_registry(entry_points: bool = True) -> Registry:
    """Built-ins, then every installed plugin. Never raises for a broken plugin."""
    from panobench import builtins

    manager = pluggy.PluginManager("panobench")
    manager.add_hookspecs(hookspecs)
    registry = Registry(manager)
    registry.add_plugin(builtins, "panobench.builtins", "built-in")
    if not entry_points:
        return registry
    for entry in sorted(importlib.metadata.entry_points(group=ENTRY_POINT_GROUP), key=lambda e: e.name):
        dist = entry.dist
        origin = f"{dist.name} {dist.version}" if dist else entry.name
        try:
            registry.add_plugin(entry.load(), f"{origin}:{entry.name}", origin)
        except (Exception, SystemExit) as error:  # a stranger's import may raise anything
            registry.failures[entry.name] = f"{type(error).__name__}: {error}"
            if manager.has_plugin(f"{origin}:{entry.name}"):
                manager.unregister(name=f"{origin}:{entry.name}")
            warnings.warn(
                f"plugin '{entry.name}' ({origin}) is skipped: {type(error).__name__}: {error}",
                PluginWarning,
                stacklevel=2,
            )
    return registry


@lru_cache(maxsize=1)
def registry() -> Registry:
    """The process's registry, loaded once."""
    return load_registry()

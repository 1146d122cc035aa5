"""Hash the code and data that a stored result depends on.

The code of an object is its module and every module of the same top-level packages that it imports, directly or
not, at the top or inside functions. Other packages count by their version.
"""

from __future__ import annotations

import dis
import hashlib
import importlib
import importlib.metadata
import importlib.util
import json
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

#: Packages whose version changes numbers.
NUMERICAL_PACKAGES = ("numpy", "scipy", "numba", "torch", "opencv-python-headless", "av", "evo")
#: Parts of panobench that show or organise results and cannot change one.
_NOT_RESULTS = ("panobench.cli", "panobench.report", "panobench.studies", "panobench.testing", "panobench.builtins")
#: Entries of a provenance that say where files are; that is no content.
_PLACES = {"root", "path", "folder", "cache", "cached"}


def digest(value: Any) -> str:
    """SHA-256 of plain values, independent of the order of keys."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def code_fingerprint(implementations: Iterable[str]) -> str:
    """Hash of the source behind "module:Name" implementations, and of panobench's runner.

    A module without source (compiled, missing) counts by name and its distribution's version.
    """
    roots = {path.partition(":")[0] for path in implementations if path} | {"panobench.bench.run.runner"}
    packages = {root.partition(".")[0] for root in roots} | {"panobench"}
    modules: dict[str, str] = {}
    waiting = sorted(roots)
    while waiting:
        name = waiting.pop()
        if not name or name in modules or name.partition(".")[0] not in packages or _is_not_results(name):
            continue
        if name not in roots and _spec(name) is None:
            # a name imported from a module; the package may export it from another module on first use
            waiting += _exporting_module(name)
            continue
        source = _source(name)
        # an empty file is source too; looking up distributions takes a third of a second
        modules[name] = _version_of(name) if source is None else source
        # importing a module runs the packages around it
        waiting += [*_imports(name), name.rpartition(".")[0]]
    return digest(modules)


def environment_fingerprint() -> dict[str, str]:
    """Versions of Python and of the packages that compute, and whether there is a GPU."""
    found = {"python": ".".join(platform.python_version_tuple()[:2])}
    for name in NUMERICAL_PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    from panobench.splat.backend import driver_present

    if driver_present():  # --device auto may compute elsewhere than without it
        found["gpu"] = "cuda"
    return found


def data_fingerprint(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A sequence's provenance, without the places of its files."""
    return {k: _without_places(v) for k, v in provenance.items() if k not in _PLACES}


def _without_places(value: Any) -> Any:
    return data_fingerprint(value) if isinstance(value, Mapping) else value


def _is_not_results(name: str) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in _NOT_RESULTS)


@cache
def _spec(name: str) -> Any:
    """The module's import spec. Only the packages above it are imported, never the module itself."""
    parent = name.rpartition(".")[0]
    if parent and not _is_package(parent):
        return None
    try:
        return importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return None


def _exporting_module(name: str) -> list[str]:
    """The module from which panobench's packages export a name on first use (``_WHERE`` in their __init__)."""
    package, _, attribute = name.rpartition(".")
    if package.partition(".")[0] != "panobench" or not _is_package(package):
        return []
    where = getattr(importlib.import_module(package), "_WHERE", {}).get(attribute)
    return [] if where is None else [where]


def _is_package(name: str) -> bool:
    spec = _spec(name)
    return spec is not None and spec.submodule_search_locations is not None


@cache
def _source(name: str) -> str | None:
    spec = _spec(name)
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        return None
    path = Path(spec.origin)
    try:
        text = path.read_text(encoding="utf-8")
        # code in another language, which a package compiles
        others = sorted(path.parent.glob("kernels/*.cu")) if path.name == "__init__.py" else []
        return text + "".join(other.read_text(encoding="utf-8") for other in others)
    except (OSError, UnicodeDecodeError):
        return None


@cache
def _distributions() -> Mapping[str, list[str]]:
    """Top-level package -> its distributions. Finding out reads the file list of everything installed."""
    return importlib.metadata.packages_distributions()


@cache
def _version_of(name: str) -> str:
    distributions = _distributions().get(name.partition(".")[0], ())
    return " ".join(f"{d} {importlib.metadata.version(d)}" for d in sorted(set(distributions)))


@cache
def _imports(name: str) -> list[str]:
    """The modules that a module imports, and the names it takes from them.

    From the compiled code, not the syntax tree: CPython 3.11 can fail to build the latter in a second thread.
    """
    try:
        code = compile(_source(name) or "", name, "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return []
    package = name if _is_package(name) else name.rpartition(".")[0]
    found: set[str] = set()
    waiting = [code]
    while waiting:
        part = waiting.pop()
        for constant in part.co_consts:
            if isinstance(constant, CodeType):
                waiting.append(constant)
            elif isinstance(constant, str):
                found.update(_lazy_reference(constant))
        found.update(_imported_by(part, package))
    return sorted(f for f in found if f)


def _imported_by(code: CodeType, package: str) -> set[str]:
    """Operands of the import instructions: before each stand the relative level and the names taken from it."""
    found: set[str] = set()
    constants: list[Any] = []
    for instruction in dis.get_instructions(code):
        if instruction.opname == "IMPORT_NAME":
            level, names = constants[-2:]
            base = instruction.argval
            if level:
                parent = package.split(".")[: len(package.split(".")) - level + 1]
                base = ".".join([*parent, *([base] if base else [])])
            found.add(base)
            # "from package import module" names a module too; which of them are is seen when they are looked up
            found.update(f"{base}.{n}" for n in names or () if n != "*")
        elif instruction.opname in ("LOAD_CONST", "LOAD_SMALL_INT"):
            constants.append(instruction.argval)
    return found


def _lazy_reference(text: str) -> set[str]:
    """The module of a "package.module:Name" string, as specs write it."""
    module, colon, name = text.partition(":")
    if not colon or not name.isidentifier() or "." not in module:
        return set()
    return {module} if all(part.isidentifier() for part in module.split(".")) else set()

"""Programs that are Python packages: a script of the adapter, run by an interpreter that has the package."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path
from typing import ClassVar

from panobench.external.adapter import ExternalConfig, ExternalMethod
from panobench.external.findings import Finding
from panobench.external.launch import Place


class PythonPackageMethod(ExternalMethod):
    """Base class. ``package`` is the import name, ``install`` one line on how to get it.

    The script runs in a process of its own: with panobench's interpreter, or with the one of ``run_in``.
    """

    package: ClassVar[str]
    install: ClassVar[str]
    program: ClassVar[str] = "python"

    def command(self) -> str:
        """panobench's own interpreter, unless another program or place is named."""
        named = super().command()
        return sys.executable if named == self.program and self.place().kind == "local" else named

    @classmethod
    def package_problem(cls, place: Place) -> str | None:
        """None if the package can be used at ``place``, otherwise one line. Conda and containers are trusted."""
        if place.kind not in ("local", "venv") or find_package(place, cls.package) is not None:
            return None
        where = f" in {place.target}" if place.target else ""
        return f"the package {cls.package} is not installed{where}; {cls.install}"

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        reason = super().missing(config)
        if reason is None and cls(config).command() in (sys.executable, cls.program):
            reason = cls.package_problem(cls(config).place())
        return reason

    @classmethod
    def diagnose(cls) -> list[Finding]:
        found = super().diagnose()
        if not found[0].ok:
            return found
        problem = cls.package_problem(cls().place())
        return [*found, Finding(problem is None, cls.package, problem or "installed", cls.install)]


def find_package(place: Place, name: str) -> Path | None:
    """The folder of a package in this interpreter's or in a virtual environment; it is not imported."""
    if place.kind == "venv":
        folders = sorted(Path(place.target).glob(f"lib/python3*/site-packages/{name}"))
        return folders[0] if folders else None
    spec = importlib.util.find_spec(name)
    if spec is None:
        return None
    places = [Path(p) for p in (spec.submodule_search_locations or ())]
    return places[0] if places else Path(spec.origin or name)


def copy_script(script: Path, work: Path) -> Path:
    """A copy of an adapter's script in the work folder, where containers see it too."""
    return Path(shutil.copyfile(script, work / script.name))

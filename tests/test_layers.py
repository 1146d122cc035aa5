"""Which package may import which: the table in CONTRIBUTING.md, checked on the imports as they stand in the files.

Imports inside functions and under ``if TYPE_CHECKING`` are left out: they do not order the packages.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import panobench

ROOT = Path(panobench.__file__).parent
ABOVE_METHODS = {"bench", "report", "studies", "viewer", "testing", "cli"}
#: What the modules of a package must not import.
FORBIDDEN = {
    "cameras": {"kernels", "datasets", "photometric", "splat", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "datasets": {"photometric", "splat", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "trajectories": {"photometric", "splat", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "photometric": {"splat", "datasets", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "inertial": {"kernels", "datasets", "photometric", "splat", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "gpu": {"splat", "photometric", "datasets", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "splat": {"photometric", "datasets", "depth", "methods", "metrics"} | ABOVE_METHODS,
    "depth": {"splat", "methods", "metrics"} | ABOVE_METHODS,
    "methods": {"metrics"} | ABOVE_METHODS,
    "metrics": {"photometric", "splat", "depth", "methods"} | ABOVE_METHODS,
    "verdict": {"photometric", "splat", "depth", "methods"} | ABOVE_METHODS,
    "bench": {"report", "studies", "viewer", "testing", "cli"},
    "report": {"studies", "methods", "viewer", "testing", "cli"},
    "studies": {"report", "viewer", "testing", "cli"},
}


def imported(source: str) -> Iterator[str]:
    """The packages or modules directly below panobench that ``source`` imports when it is imported itself."""
    statements: list[ast.AST] = [ast.parse(source)]
    while statements:
        node = statements.pop()
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            statements += node.orelse
            continue
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name.split(".")[1] for name in names if name.startswith("panobench."))
        statements += ast.iter_child_nodes(node)


def broken(package: str, sources: dict[str, str], forbidden: set[str]) -> list[str]:
    """'file imports package' for each import that is not allowed. sources: text by name of the file."""
    return [
        f"{package}/{name} imports {other}"
        for name, text in sources.items()
        for other in sorted(set(imported(text)) & forbidden)
    ]


def sources_of(package: str) -> dict[str, str]:
    folder = ROOT / package
    found = {str(p.relative_to(folder)): p.read_text(encoding="utf-8") for p in sorted(folder.rglob("*.py"))}
    assert found
    return found


@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_package_imports_one_above_it(package: str) -> None:
    assert broken(package, sources_of(package), FORBIDDEN[package]) == []


def test_kernels_import_nothing_of_panobench() -> None:
    assert {name for text in sources_of("kernels").values() for name in imported(text)} <= {"kernels"}


def test_a_forbidden_import_is_found_wherever_it_stands_at_the_top_level() -> None:
    text = """
from typing import TYPE_CHECKING
import numpy
from panobench import errors
from panobench.cameras.base import Camera
try:
    import panobench.photometric.warp
except ImportError:
    pass
if TYPE_CHECKING:
    from panobench.methods.base import Method
def lazily():
    from panobench.report.build import build
class Late:
    from panobench.studies import base
"""
    assert set(imported(text)) == {"errors", "cameras", "photometric", "studies"}
    found = broken("splat", {"a.py": text, "b.py": "import numpy"}, FORBIDDEN["splat"])
    assert found == ["splat/a.py imports photometric", "splat/a.py imports studies"]


def test_methods_share_splatting_and_nothing_of_panogs() -> None:
    """What two methods use belongs to neither; here text is enough, imports in functions count too."""
    sources = {n: t for n, t in sources_of("methods").items() if not n.startswith("panogs/") and n != "registration.py"}
    assert len(sources) > 40
    assert [name for name, text in sources.items() if "methods.panogs" in text] == []

"""What ``panobench.external`` offers is there, is documented, and is all that the packages under plugins/ use of it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import panobench.external

ROOT = Path(__file__).parents[2]
#: The modules that the contract covers (docs/plugins.md); all others may change at any time.
PUBLIC = {"panobench", "panobench.geometry", "panobench.testing", "panobench.external"}
FILES = sorted((ROOT / "plugins").rglob("*.py"))


@pytest.mark.parametrize("name", panobench.external.__all__)
def test_each_name_is_there_and_documented(name: str) -> None:
    assert getattr(panobench.external, name) is not None
    assert f"`{name}`" in (ROOT / "docs" / "plugins.md").read_text()


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = panobench.external.nothing


def imported_modules(path: Path) -> set[str]:
    """Full names of the modules that a file imports, or imports names from."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT / "plugins")))
def test_plugins_import_only_what_the_contract_covers(path: Path) -> None:
    own = {m for m in imported_modules(path) if m.split(".")[0] == "panobench"}
    assert own <= PUBLIC

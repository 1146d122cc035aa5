"""Fixtures that put fake runs into a test's own folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fake_runs import write_run, write_suite

RunWriter = Callable[..., Path]


@pytest.fixture
def make_run(tmp_path: Path) -> RunWriter:
    """``make_run("name", method=..., ...)`` writes a run folder below the test's own folder."""

    def make(name: str, **options: Any) -> Path:
        return write_run(tmp_path / "runs" / name, **options)

    return make


@pytest.fixture
def edit() -> Callable[[Path, Callable[[dict[str, Any]], None]], None]:
    """``edit(folder, change)`` rewrites a run.json in place."""

    def change_document(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
        document = json.loads((folder / "run.json").read_text())
        change(document)
        (folder / "run.json").write_text(json.dumps(document))

    return change_document


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """``write_suite`` in the test's own folder."""
    return write_suite(tmp_path / "runs")

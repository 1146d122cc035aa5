"""The plugin documentation: complete, and what it shows runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from document_blocks import DOCS, blocks, make_environment, run_block

from panobench import hookspecs, specs

PLUGINS = (DOCS / "plugins.md").read_text(encoding="utf-8")


def hook_names() -> list[str]:
    return [n for n, f in vars(hookspecs).items() if hasattr(f, "panobench_spec")]


def test_there_are_hooks_to_document() -> None:
    assert "register_methods" in hook_names()
    assert "run_finished" in hook_names()


@pytest.mark.parametrize("hook", hook_names())
def test_every_hook_is_documented_with_its_arguments(hook: str) -> None:
    code = getattr(hookspecs, hook).__code__
    arguments = ", ".join(code.co_varnames[: code.co_argcount])
    assert f"`{hook}({arguments})`" in PLUGINS


@pytest.mark.parametrize(
    "spec",
    [s for s in vars(specs).values() if isinstance(s, type) and issubclass(s, specs.Spec)],
    ids=lambda s: s.__name__,
)
def test_every_field_of_every_spec_is_documented(spec: type[specs.Spec]) -> None:
    if spec is not specs.Spec:
        assert f"`{spec.__name__}`" in PLUGINS
    missing = [f.name for f in dataclasses.fields(spec) if f"`{f.name}`" not in PLUGINS]
    assert not missing


def test_the_contract_version_is_the_documented_one() -> None:
    assert f"`panobench.CONTRACT_VERSION` is **{specs.CONTRACT_VERSION}**" in PLUGINS


def test_the_complete_example_keeps_the_contract(tmp_path: Path) -> None:
    environment = make_environment(tmp_path / "venv")
    shown = [b for b in blocks(DOCS / "plugins.md") if b.language == "python"]
    assert [b.target for b in shown] == [None, "panobench_still.py", None]
    for block in shown:
        run_block(block, tmp_path, environment)


def test_the_tutorial_works_from_the_first_command_to_the_last(tmp_path: Path) -> None:
    environment = make_environment(tmp_path / "venv")
    work = tmp_path / "work"
    work.mkdir()
    shown = blocks(DOCS / "tutorial-plugin.md")
    assert {b.language for b in shown} == {"sh", "python"}
    for block in shown:
        run_block(block, work, environment)

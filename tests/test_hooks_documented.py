"""Every hook, its arguments and every spec field is named in docs/plugins.md."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path

import pytest

from panobench import hookspecs, specs

DOCS = Path(__file__).parent.parent / "docs" / "plugins.md"
HOOKS = {
    name: function
    for name, function in vars(hookspecs).items()
    if inspect.isfunction(function) and hasattr(function, "panobench_spec")
}


def test_the_hooks_are_found() -> None:
    assert {"register_cameras", "register_methods", "run_started", "frame_done", "run_finished"} <= set(HOOKS)


@pytest.mark.parametrize("name", HOOKS)
def test_every_hook_is_documented_with_its_arguments(name: str) -> None:
    text = DOCS.read_text(encoding="utf-8")
    signature = f"`{name}({', '.join(inspect.signature(HOOKS[name]).parameters)})`"
    assert signature in text, f"docs/plugins.md does not explain {signature}"
    assert (HOOKS[name].__doc__ or "").strip(), f"{name} has no docstring"


@pytest.mark.parametrize(
    "spec", [specs.CameraSpec, specs.DatasetSpec, specs.DepthSpec, specs.MethodSpec, specs.MetricSpec, specs.StudySpec]
)
def test_every_spec_field_is_documented(spec: type[specs.Spec]) -> None:
    text = DOCS.read_text(encoding="utf-8")
    assert f"`{spec.__name__}`" in text
    missing = [f.name for f in dataclasses.fields(spec) if f"`{f.name}`" not in text and f"{f.name}=" not in text]
    assert not missing, f"docs/plugins.md does not explain {spec.__name__}.{', '.join(missing)}"

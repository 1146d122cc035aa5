"""`panobench list methods NAME`: every option with its default, unit and help."""

from __future__ import annotations

import json

import pytest

from panobench.cli.list import _option_lines
from panobench.cli.main import run as panobench
from panobench.options import OptionDescription, option_names
from panobench.plugins import registry
from panobench.specs import MethodSpec, load_object

OPTIONS = [
    OptionDescription("a", 0.5, "a number", "px", "the first of the options that there are", "above 0", "One"),
    OptionDescription("two.b", None, "text or none", "", "the second", "", "Two"),
]


def test_every_option_of_a_method_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("panogs", "sparse"):
        spec = registry().get(MethodSpec, name)
        known = option_names(load_object(spec.config or "", name)())
        assert panobench(["list", "methods", name, "--json"]) == 0
        assert sorted(o["name"] for o in json.loads(capsys.readouterr().out)["options"]) == sorted(known)
        assert panobench(["list", "methods", name]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert all(any(line.startswith(f"  {option} ") for line in lines) for option in known)


@pytest.mark.usefixtures("fake_plugin")
def test_a_preset_is_shown_as_what_it_sets(capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["list", "method", "fake-options"]) == 0
    assert "Preset quick\n  features=10 inner.gain=0.1" in capsys.readouterr().out


def test_columns_are_aligned_and_long_help_is_wrapped() -> None:
    assert list(_option_lines(OPTIONS, 50)) == [
        "",
        "Options: One",
        "  a      0.5 px  the first of the options that",
        "                 there are; above 0",
        "",
        "Options: Two",
        "  two.b  none    the second; text or none",
    ]
    assert max(map(len, _option_lines(OPTIONS, 20))) > 50, "too narrow for columns"


def test_entries_wrap_between_words_at_80_columns(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert panobench(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    start = next(i for i, line in enumerate(lines) if line.startswith("  disturbed"))
    assert lines[start + 1].startswith(" " * 20), "the rest stands below the summary, not below the name"


@pytest.mark.parametrize("command", [["run"], ["report"], ["plugin", "check"], ["doctor"]])
def test_help_shows_neither_types_of_switches_nor_completion(command, capsys: pytest.CaptureFixture[str]) -> None:
    panobench([*command, "--help"])
    shown = capsys.readouterr().out
    assert "--help" in shown
    assert "<bool>" not in shown
    assert "--install-completion" not in shown

"""docs/command-line.md says what the commands do."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from panobench.cli.commands import COMMANDS
from panobench.cli.lazy import load_command
from panobench.cli.main import run as panobench

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "command-line.md").read_text(encoding="utf-8")


def commands() -> dict[str, object]:
    """Every command that can be typed, groups taken apart."""
    found = {}
    for name in COMMANDS:
        command = load_command(name)
        inner = getattr(command, "commands", None)
        found.update({f"{name} {k}": v for k, v in inner.items()} if inner else {name: command})
    return found


def named(pattern: str) -> set[str]:
    lines = re.findall(pattern, TEXT, re.DOTALL)
    return {word for line in lines for word in re.findall(r"`([a-z ]+)`", line)}


def test_every_command_has_its_exit_codes() -> None:
    table = TEXT.split("| command | 1 means |")[1].split("\n\n")[0]
    words = set(re.findall(r"`([a-z ]+)`", table))
    for name in commands():
        assert name in words or name.split()[0] in words, name


def test_commands_with_json_are_those_named() -> None:
    with_json = {n for n, c in commands().items() if any("--json" in p.opts for p in c.params)}  # type: ignore[attr-defined]
    assert with_json == named(r"- `--json` prints(.*?)\n- ")


@pytest.mark.parametrize(
    ("words", "code"), [(["list"], 0), (["lst"], 2), (["run", "--widht", "3"], 2), (["run", "--method", "none"], 2)]
)
def test_exit_codes(words: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(words) == code
    error = capsys.readouterr().err
    assert (error.startswith("panobench: ") and error.count("\n") == 1) == (code == 2)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("panobench ru", "run"), ("panobench run --me", "--method"), ("panobench suite st", "status")],
)
def test_the_shell_completes(typed: str, offered: str) -> None:
    environment = {"COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" ")), "_PANOBENCH_COMPLETE": "complete_bash"}
    code = "from panobench.cli.main import app; app(prog_name='panobench')"
    answer = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert offered in answer.stdout.split()

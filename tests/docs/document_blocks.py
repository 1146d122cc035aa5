"""Fenced code blocks of a Markdown page, and a throw-away environment in which its shell commands run verbatim."""

from __future__ import annotations

import os
import re
import site
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language and text. target: the path of a leading ``# file: PATH`` comment, or None."""

    language: str
    text: str
    line: int

    @property
    def target(self) -> str | None:
        match = re.match(r"# file: (\S+)\n", self.text)
        return match[1] if match else None


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [Block(m[1], m[2], text[: m.start()].count("\n") + 2) for m in _BLOCK.finditer(text)]


def make_environment(folder: Path) -> dict[str, str]:
    """A virtual environment that sees this one's packages, where pip installs offline; the variables to run in it."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    python = folder / "bin" / "python"
    library = folder / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    parents = "; ".join(f"site.addsitedir({p!r})" for p in site.getsitepackages())
    (library / "parent.pth").write_text(f"import site; {parents}\n")
    commands = {
        "panobench": "from panobench.cli.main import main; main()",
        "pytest": "import sys, pytest; sys.exit(pytest.main())",
    }
    for name, code in commands.items():
        _executable(folder / "bin" / name, f"#!{python}\n{code}\n")
    _executable(folder / "bin" / "pip", f'#!/bin/sh\nexec "{sys.executable}" -m pip --python "{python}" "$@"\n')
    return {
        **os.environ,
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PIP_NO_DEPS": "1",
        "PIP_NO_INDEX": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this variable the other way round
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _executable(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


def run_block(block: Block, folder: Path, environment: dict[str, str]) -> None:
    """Write the block's file, or run it; AssertionError with the output if that fails."""
    if block.target is not None:
        path = folder / block.target
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text)
        return
    command = {"sh": ["bash", "-euc", block.text], "python": ["python", "-c", block.text]}[block.language]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"block at line {block.line} fails:\n{block.text}\n{done.stdout}\n{done.stderr}"

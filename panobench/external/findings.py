"""What `panobench doctor` shows about a method, and what can be said about a program without running it."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Finding:
    """Something that a method needs: whether it is there, what was found, and what to do if it is missing."""

    ok: bool
    what: str
    detail: str
    fix: str = ""


def missing_libraries(program: Path) -> list[str]:
    """The shared libraries that an ELF file needs and the loader does not find. Empty for scripts, or without ``ldd``.

    Call it only for programs and extension modules that the user named or installed: ``ldd`` may run the file's loader.
    """
    ldd = shutil.which("ldd")
    try:
        with program.open("rb") as file:
            elf = file.read(4) == b"\x7fELF"
        if ldd is None or not elf:
            return []
        done = subprocess.run([ldd, str(program)], capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.SubprocessError):
        return []
    return sorted({line.split("=>")[0].strip() for line in done.stdout.splitlines() if "not found" in line})


def library_finding(what: str, program: Path, fix: str) -> Finding:
    """Whether the loader finds the shared libraries of a program or an extension module."""
    missing = missing_libraries(program)
    return Finding(not missing, what, f"needs {', '.join(missing)}" if missing else "all found", fix)

"""Where a program runs: locally, in a virtual or conda environment, or in a docker or apptainer container.

A place is written as ``local``, ``venv:FOLDER``, ``conda:NAME`` (or ``conda:/PREFIX``), ``docker:IMAGE`` or
``apptainer:IMAGE``. Containers mount folders at the same paths, so that the command line is the same everywhere.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from panobench.errors import UnavailableError, UsageError
from panobench.external import confine

KINDS = ("local", "venv", "conda", "docker", "apptainer")


@dataclass(frozen=True)
class Launch:
    """A command line and its environment. ``stop`` ends what runs outside the process group (a container)."""

    argv: list[str]
    environment: dict[str, str]
    confined: bool
    stop: Callable[[], None] | None = None


@dataclass(frozen=True)
class Place:
    """kind: one of ``KINDS``. target: the folder or name of the environment, or the image."""

    kind: str
    target: str = ""

    @property
    def tool(self) -> str | None:
        """The program that starts environments or containers of this kind, None if none is needed."""
        return self.kind if self.kind in ("conda", "docker", "apptainer") else None

    def problem(self) -> str | None:
        """None if programs can be started there, otherwise one line that says why not."""
        if self.tool is not None and shutil.which(self.tool) is None:
            return f"the program '{self.tool}' is not on PATH, needed for '{self.kind}:{self.target}'"
        if self.kind == "venv" and not (Path(self.target) / "bin" / "python").exists():
            return f"{self.target} is no virtual environment: it has no bin/python"
        return None

    def find(self, program: str) -> str | None:
        """Full path of a program, or None. Inside conda environments and containers programs are assumed to exist."""
        if self.kind == "local":
            return shutil.which(program)
        if self.kind == "venv":
            return shutil.which(program, path=f"{Path(self.target) / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}")
        return program

    def launch(
        self,
        argv: list[str],
        work: Path,
        environment: Mapping[str, str],
        reads: tuple[Path, ...] = (),
        cwd: Path | None = None,
    ) -> Launch:
        """How to start ``argv`` there, with ``work`` writable and ``reads`` readable. Raises UnavailableError."""
        reason = self.problem()
        if reason is not None:
            raise UnavailableError(reason)
        work = work.resolve()
        cwd = (cwd or work).resolve()
        variables = dict(environment)
        if self.kind == "docker":
            return self._docker(argv, work, variables, reads, cwd)
        if self.kind == "apptainer":
            mounts = [f"{work}:{work}", *(f"{_mountable(p)}:{_mountable(p)}:ro" for p in reads)]
            binds = [word for m in mounts for word in ("--bind", m)]
            command = ["apptainer", "exec", "--containall", "--cleanenv", "--pwd", str(cwd), *binds, self.target]
            return Launch([*command, *argv], variables, confined=True)
        found = self.find(argv[0])
        if found is None:
            raise UnavailableError(f"the program '{argv[0]}' is not there ({self.kind})")
        if self.kind == "conda":
            where = ["-p" if os.sep in self.target else "-n", self.target]
            # conda finds its environments below the real home
            variables["HOME"] = os.environ.get("HOME", variables.get("HOME", ""))
            argv = ["conda", "run", "--no-capture-output", *where, *argv]
        else:
            if self.kind == "venv":
                variables["VIRTUAL_ENV"] = self.target
                variables["PATH"] = f"{Path(self.target) / 'bin'}{os.pathsep}{variables.get('PATH', os.defpath)}"
            argv = [found, *argv[1:]]
        if confine.landlock_version():
            script = str(Path(confine.__file__).resolve())
            return Launch([sys.executable, "-I", "-S", script, str(work), "--", *argv], variables, confined=True)
        return Launch(argv, variables, confined=False)

    def _docker(
        self, argv: list[str], work: Path, variables: dict[str, str], reads: tuple[Path, ...], cwd: Path
    ) -> Launch:
        name = f"panobench-{uuid.uuid4().hex[:12]}"
        mounts = [f"type=bind,source={_mountable(work)},target={_mountable(work)}"]
        mounts += [f"type=bind,source={_mountable(p)},target={_mountable(p)},readonly" for p in reads]
        command = ["docker", "run", "--rm", "--init", "--name", name, "--network", "none"]
        command += ["--user", f"{os.getuid()}:{os.getgid()}", "--workdir", str(cwd)]
        for mount in mounts:
            command += ["--mount", mount]
        for key, value in variables.items():
            if key not in ("PATH", "LD_LIBRARY_PATH"):  # the image has its own values
                command += ["--env", f"{key}={value}"]

        def stop() -> None:
            subprocess.run(["docker", "kill", name], capture_output=True, timeout=30, check=False)

        outer = {k: v for k, v in os.environ.items() if k in ("PATH", "HOME", "DOCKER_HOST", "XDG_RUNTIME_DIR")}
        return Launch([*command, self.target, *argv], outer, confined=True, stop=stop)


def parse_place(text: str) -> Place:
    """Parse ``local``, ``venv:...``, ``conda:...``, ``docker:...`` or ``apptainer:...``. Raises UsageError."""
    kind, _, target = text.partition(":")
    if kind not in KINDS or bool(target) != (kind != "local") or target.startswith("-"):
        raise UsageError(
            f"'{text}' is no place to run: use local, venv:FOLDER, conda:NAME, docker:IMAGE or apptainer:IMAGE"
        )
    return Place(kind, target)


def _mountable(path: Path) -> str:
    text = str(path.resolve())
    if "," in text or ":" in text:
        raise UsageError(f"a container cannot mount a path with ',' or ':': {text}")
    return text

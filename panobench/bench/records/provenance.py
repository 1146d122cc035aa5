"""Record where a run came from: versions, commit, machine. Everything here is cheap and never raises."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import re
import subprocess
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import psutil

import panobench
from panobench.bench.records.fields import JsonRecord

#: Environment variables that set the number of threads of numerical code, or the GPU.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "NUMBA_THREADING_LAYER",
    "CUDA_VISIBLE_DEVICES",
)


@dataclass
class MachineRecord(JsonRecord):
    """The machine of a run; see ``machine``."""

    cpu: str = ""
    cores: int | None = None
    memory_bytes: int | None = None
    gpus: list[str] = field(default_factory=list)
    load_1min: float | None = None
    threads: dict[str, str] = field(default_factory=dict)


@dataclass
class ProvenanceRecord(JsonRecord):
    """Where a run came from; see ``provenance``. command makes it again; dataset is what it says about its files."""

    panobench: str = ""
    commit: str | None = None
    contract: str = ""
    python: str = ""
    platform: str = ""
    packages: dict[str, str | None] = field(default_factory=dict)
    plugins: dict[str, Any] = field(default_factory=dict)
    machine: MachineRecord = field(default_factory=MachineRecord)
    started: str = ""
    dataset: dict[str, Any] = field(default_factory=dict)
    command: str = ""


def provenance() -> ProvenanceRecord:
    """The provenance of what runs now. Its ``dataset`` and ``command`` are left empty."""
    return ProvenanceRecord(
        panobench=panobench.__version__,
        commit=commit(),
        contract=panobench.CONTRACT_VERSION,
        python=platform.python_version(),
        platform=platform.platform(),
        packages=dict(packages()),
        plugins=dict(plugins()),
        machine=machine(),
        started=datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    )


def machine() -> MachineRecord:
    """Processor, cores this process may use, memory, GPU, and how busy the machine was just now."""
    return MachineRecord(
        cpu=cpu_model(),
        cores=available_cores(),
        memory_bytes=psutil.virtual_memory().total,
        gpus=gpus(),
        load_1min=round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        threads={name: os.environ[name] for name in _THREAD_VARIABLES if name in os.environ},
    )


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def cpu_model() -> str:
    try:
        match = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        match = None
    return match.group(1) if match else platform.processor() or platform.machine()


@lru_cache(maxsize=1)
def gpus() -> list[str]:
    """Names of NVIDIA GPUs, as its driver's files list them."""
    names = []
    for path in sorted(Path("/proc/driver/nvidia/gpus").glob("*/information")):
        try:
            match = re.search(r"^Model:\s*(.+)$", path.read_text(), re.MULTILINE)
        except OSError:
            continue
        names.append(match.group(1).strip() if match else path.parent.name)
    return names


@lru_cache(maxsize=1)
def commit() -> str | None:
    """The commit of the checkout panobench runs from ("+dirty" with local changes), None for an installed wheel."""
    root = Path(panobench.__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None
    head = _git(root, "rev-parse", "HEAD")
    if head is None:
        return None
    changes = _git(root, "status", "--porcelain", "--untracked-files=no", "--", "panobench")
    return head + ("+dirty" if changes else "")


def _git(root: Path, *words: str) -> str | None:
    command = ["git", "-C", str(root), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


@lru_cache(maxsize=1)
def packages() -> dict[str, str]:
    """Versions of what panobench requires and has installed."""
    found = {}
    try:
        requirements = importlib.metadata.requires("panobench") or []
    except importlib.metadata.PackageNotFoundError:
        requirements = []
    for requirement in requirements:
        if "extra ==" in requirement:
            continue
        match = re.match(r"[A-Za-z0-9._-]+", requirement)
        name = match.group(0) if match else ""
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return dict(sorted(found.items()))


def plugins() -> dict[str, str]:
    """Installed plugin distributions and their versions."""
    entries = importlib.metadata.entry_points(group="panobench")
    return {e.dist.name: e.dist.version for e in entries if e.dist is not None}

"""Fixtures for the whole suite."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import settings

# Processes that share the machine have a core each.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import panobench  # noqa: F401 - before torch, so that OpenMP's workers do not spin: see panobench.openmp

# CI repeats the same examples, so that a red run is the change's doing; runs at home keep exploring.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


PAGE = 4096


@dataclass(frozen=True)
class SmallDisk:
    """A file system of 512 KiB."""

    path: Path

    def leave(self, pages: int) -> Path:
        """Fill it but for that many pages; returns the file that does."""
        filler = self.path / "filler"
        with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(PAGE))
        os.truncate(filler, max(filler.stat().st_size - pages * PAGE, 0))
        return filler


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[SmallDisk]:
    """Needs the right to mount."""
    place = tmp_path / "disk"
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(place)], capture_output=True)
    if done.returncode:
        pytest.skip("mounting a small file system is not allowed here")
    yield SmallDisk(place)
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture(scope="session")
def fake_plugin_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that, on PYTHONPATH, makes ``tests/bench/fake_plugin.py`` an installed panobench plugin."""
    site = tmp_path_factory.mktemp("site")
    shutil.copy(Path(__file__).parent / "bench" / "fake_plugin.py", site / "fake_plugin.py")
    info = site / "panobench_fake-1.5.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: panobench-fake\nVersion: 1.5\n")
    (info / "entry_points.txt").write_text("[panobench]\nfake = fake_plugin\n")
    return site


@pytest.fixture
def fake_plugin(fake_plugin_site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The fake plugin, registered in this process and in those it starts."""
    from panobench.plugins import registry

    monkeypatch.syspath_prepend(str(fake_plugin_site))
    monkeypatch.setenv("PYTHONPATH", str(fake_plugin_site), prepend=":")
    registry.cache_clear()
    yield fake_plugin_site
    registry.cache_clear()
    sys.modules.pop("fake_plugin", None)

"""Where compiled kernels go when neither the package nor the home can be written."""

from __future__ import annotations

import contextlib
import os
import shutil
import site
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numba  # noqa: F401 - takes its folder from the environment once: before these tests change it
import pytest

import panobench
from panobench import kernel_cache
from panobench.errors import UnavailableError

NOBODY = 65534


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """What ``prepare`` decides lasts for the process."""
    monkeypatch.setattr(kernel_cache, "_note", None)
    monkeypatch.setattr(kernel_cache, "_nowhere", False)
    monkeypatch.delenv(kernel_cache.VARIABLE, raising=False)


def refuse(monkeypatch: pytest.MonkeyPatch, *allowed: Path) -> None:
    """Nothing can be written but below ``allowed``."""
    monkeypatch.setattr(
        kernel_cache, "_writable", lambda place: any(place.is_relative_to(folder) for folder in allowed)
    )


def test_nothing_is_said_where_numba_finds_a_place() -> None:
    kernel_cache.prepare()
    assert kernel_cache.note() is None
    assert kernel_cache.VARIABLE not in os.environ


def test_a_temporary_folder_is_taken_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuse(monkeypatch)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    kernel_cache.prepare()
    folder = Path(os.environ[kernel_cache.VARIABLE])
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700
    line = str(kernel_cache.note())
    assert str(folder) in line
    assert "set NUMBA_CACHE_DIR to a folder that is kept" in line
    assert "\n" not in line
    kernel_cache.prepare()  # a second process takes the same
    assert Path(os.environ[kernel_cache.VARIABLE]) == folder


def test_a_folder_that_others_could_write_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels are code: what lies in the cache is executed."""
    refuse(monkeypatch)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    open_to_all = tmp_path / f"panobench-kernels-{os.geteuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    kernel_cache.prepare()
    assert Path(os.environ[kernel_cache.VARIABLE]) != open_to_all
    shutil.rmtree(open_to_all)
    (tmp_path / "elsewhere").mkdir()
    open_to_all.symlink_to(tmp_path / "elsewhere")
    monkeypatch.delenv(kernel_cache.VARIABLE)
    kernel_cache.prepare()
    assert Path(os.environ[kernel_cache.VARIABLE]) != open_to_all


def test_a_given_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv(kernel_cache.VARIABLE, "/proc/nowhere")
    refuse(monkeypatch)
    kernel_cache.prepare()
    assert "NUMBA_CACHE_DIR=/proc/nowhere cannot be written" in str(kernel_cache.note())
    assert os.environ[kernel_cache.VARIABLE].startswith(str(tmp_path))


def test_without_any_place_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    refuse(monkeypatch)
    monkeypatch.setattr(kernel_cache, "_temporary", lambda: None)
    kernel_cache.prepare()
    with pytest.raises(UnavailableError, match="set NUMBA_CACHE_DIR to a folder that can"):
        kernel_cache.require()


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A temporary folder that other users can look into, as pytest's are not."""
    folder = Path(tempfile.mkdtemp(prefix="panobench-test-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def python_for_everyone() -> str:
    """A Python of this version that another user can start."""
    for python in (sys.executable, f"/usr/bin/python3.{sys.version_info.minor}"):
        with contextlib.suppress(OSError):
            if subprocess.run([python, "-c", ""], user=NOBODY, group=NOBODY, extra_groups=[]).returncode == 0:
                return python
    pytest.skip("no Python that another user can start")


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
def test_a_user_who_can_write_nowhere(open_folder: Path) -> None:
    """A package of root's, a home that does not exist: kernels compile, and one line says where they go."""
    tmp_path = open_folder
    python = python_for_everyone()
    copy = tmp_path / "site" / "panobench"
    shutil.copytree(Path(panobench.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__", "weights"))
    subprocess.run(["chmod", "-R", "a+rX", str(tmp_path)], check=True)
    place = tmp_path / "temporary"
    place.mkdir(mode=0o777)
    place.chmod(0o777)
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from panobench import kernel_cache; print(kernel_cache.note());"
        "from panobench.methods.sparse.patches import tangent_basis; print(tangent_basis(1.0, 0.0, 0.0))"
    )
    environment = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    environment["PYTHONPATH"] = os.pathsep.join(site.getsitepackages())  # another Python has not these packages
    done = subprocess.run(
        [python, "-c", code, str(copy.parent)],
        env={**environment, "HOME": "/nonexistent", "TMPDIR": str(place), "PYTHONDONTWRITEBYTECODE": "1"},
        user=NOBODY, group=NOBODY, extra_groups=[], cwd="/", capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "neither the package nor the home can be written" in done.stdout
    assert list(place.rglob("*.nbi"))

"""The hash of a method's code covers what it imports, directly or not, and nothing that only shows results."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from panobench.bench.suite import fingerprint
from panobench.bench.suite.fingerprint import code_fingerprint, data_fingerprint, digest

FILES = {
    "__init__.py": "",
    "method.py": (
        "from demo_plugin import near\nfrom .inner.deep import value\nimport os, json as j\n"
        "class M:\n    def f(self):\n        def g():\n            import demo_plugin.lazy\n        return g\n"
        "SPEC = 'demo_plugin.named:Thing'\n"
    ),
    "near.py": "from . import sibling\nfrom .inner import *\n",
    "sibling.py": "x = 1\n",
    "lazy.py": "from panobench.cameras.base import Camera\n",
    "named.py": "x = 1\n",
    "unrelated.py": "x = 1\n",
    "inner/__init__.py": "from ..above import y\n",
    "inner/deep.py": "value = 1\n",
    "above.py": "y = 1\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = tmp_path / "demo_plugin"
    for name, text in FILES.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [m for m in sys.modules if m.partition(".")[0] == "demo_plugin"]:
        del sys.modules[name]
    return root


def hash_now() -> str:
    for function in (fingerprint._spec, fingerprint._source, fingerprint._imports):
        function.cache_clear()
    return code_fingerprint(["demo_plugin.method:M"])


@pytest.mark.parametrize("name", [n for n in FILES if n not in ("unrelated.py",)])
def test_every_module_that_can_be_imported_counts(package: Path, name: str) -> None:
    before = hash_now()
    assert hash_now() == before
    (package / name).write_text(FILES[name] + "# changed\n")
    assert hash_now() != before


def test_a_name_that_panobench_exports_lazily_counts_with_its_module(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Adapters import the base classes of panobench.external, which its __init__ takes from modules on first use."""
    (package / "near.py").write_text("from panobench.external import MonoEurocMethod\n")
    source = fingerprint._source

    def edited(name: str) -> str | None:
        return f"{source(name)}# changed\n" if name == "panobench.external.orb_slam" else source(name)

    used = hash_now()
    monkeypatch.setattr(fingerprint, "_source", edited)
    assert code_fingerprint(["demo_plugin.method:M"]) != used
    monkeypatch.undo()
    (package / "near.py").write_text("")
    unused = hash_now()
    monkeypatch.setattr(fingerprint, "_source", edited)
    assert code_fingerprint(["demo_plugin.method:M"]) == unused


def test_other_modules_do_not_count(package: Path) -> None:
    before = hash_now()
    (package / "unrelated.py").write_text("x = 2\n")
    assert hash_now() == before


def test_heavy_packages_are_not_imported_to_be_hashed() -> None:
    code = (
        "import sys; from panobench.bench.suite.fingerprint import code_fingerprint\n"
        "code_fingerprint(['panobench.methods.sparse.method:SparseMethod', 'panobench.metrics.rendering:x'])\n"
        "print([m for m in ('numba', 'torch', 'cv2', 'scipy', 'evo') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_a_module_that_is_not_there_still_has_a_hash() -> None:
    assert code_fingerprint(["no_such_package.module:X"]) != code_fingerprint(["json:dumps"])


def test_data_count_by_content_not_by_place() -> None:
    here = {"root": "/a", "sha256": "1", "conversion": {"path": "/x", "scale": 2}}
    there = {"root": "/b", "sha256": "1", "conversion": {"path": "/y", "scale": 2}}
    assert data_fingerprint(here) == data_fingerprint(there) == {"sha256": "1", "conversion": {"scale": 2}}
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1}) != digest({"a": 2, "b": 1})


def test_files_are_read_once_while_a_suite_is_planned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from panobench.datasets.files import checksums

    read: list[str] = []
    plainly = checksums.sha256_file
    monkeypatch.setattr(checksums, "sha256_file", lambda path: read.append(path.name) or plainly(path))
    files = [tmp_path / name for name in ("a", "b")]
    for path in files:
        path.write_text("0123")
    first = checksums.files_provenance(files)
    assert checksums.files_provenance(files) == first
    assert read == ["a", "b"]
    files[1].write_text("4567")  # as long as before
    os.utime(files[1], ns=(1, 1))
    assert checksums.files_provenance(files)["sha256"] != first["sha256"]
    assert read == ["a", "b", "b"]


def test_results_of_a_machine_with_a_gpu_are_others(monkeypatch: pytest.MonkeyPatch) -> None:
    from panobench.splat import backend

    monkeypatch.setattr(backend, "driver_present", lambda: False)
    without = fingerprint.environment_fingerprint()
    assert "gpu" not in without
    monkeypatch.setattr(backend, "driver_present", lambda: True)
    assert fingerprint.environment_fingerprint() == {**without, "gpu": "cuda"}


def test_the_code_of_a_gpus_kernels_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "__global__" in (fingerprint._source("panobench.gpu") or "")

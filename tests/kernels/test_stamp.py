"""A cached kernel is not loaded once something that is compiled into it has changed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import panobench
from panobench.kernels import stamp as stamps
from panobench.splat import binning

ROOT = Path(panobench.__file__).parent


def test_numba_stamps_kernels_by_what_they_import() -> None:
    of_bin_tiles = stamps.stamp(ROOT / "splat" / "binning.py")
    assert binning.bin_tiles._cache._cache_file._source_stamp == of_bin_tiles


def test_what_is_compiled_into_a_kernel_counts() -> None:
    files = stamps.with_imports(ROOT / "splat" / "binning.py")
    assert {ROOT / "splat" / "row_bounds.py", ROOT / "kernels" / "columns.py", ROOT / "kernels" / "jit.py"} <= files
    assert ROOT / "splat" / "render.py" not in files


def test_a_change_far_down_changes_the_stamp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stamps, "_ROOT", tmp_path)
    texts = {
        "outer.py": "from panobench.inner import (\n    a,\n    b,\n)\n",
        "inner.py": "from panobench import constants, other as another\ndef a():\n    from panobench.late import c\n",
        "constants.py": "X = 1\n",
        "other.py": "",
        "late.py": "",
    }

    def stamp_with(**changed: str) -> str:
        for name, text in {**texts, **{f"{k}.py": v for k, v in changed.items()}}.items():
            (tmp_path / name).write_text(text)
        stamps.stamp.cache_clear()
        stamps._imported.cache_clear()
        return stamps.stamp(tmp_path / "outer.py")

    before = stamp_with()
    assert stamp_with() == before
    assert stamp_with(constants="X = 2\n") != before
    assert stamp_with(other="Y = 1\n") != before
    assert stamp_with(late="Z = 1\n") == before  # kernels cannot call what is imported inside a function
    stamps.stamp.cache_clear()
    stamps._imported.cache_clear()


def test_no_kernel_takes_numbas_own_decorator() -> None:
    direct = re.compile(r"^from numba import .*\bnjit\b|\bnumba\.njit\b", re.M)
    found = {p.relative_to(ROOT).as_posix() for p in ROOT.rglob("*.py") if direct.search(p.read_text("utf-8"))}
    assert found == {"kernels/jit.py"}


def test_processes_save_one_kernel_at_a_time() -> None:
    from numba.core.caching import IndexDataCacheFile

    assert hasattr(IndexDataCacheFile.save, "__wrapped__")

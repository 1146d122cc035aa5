"""Which device a run gets. Without a GPU nothing is loaded; with one that cannot be used, one line says why."""

from __future__ import annotations

import subprocess
import sys

import pytest
from cuda_devices import emulated

from panobench.errors import UnavailableError
from panobench.external.findings import Finding
from panobench.gpu import checks
from panobench.splat import backend


def test_without_a_driver_the_choice_loads_nothing() -> None:
    code = """
import ctypes, sys
class NoDriver:
    def __new__(cls, *_):
        raise OSError("no such library")
ctypes.CDLL = NoDriver
from panobench.splat.backend import open_device
assert open_device("auto") == open_device("cpu") == (None, "")
print([m for m in sys.modules if m == "torch" or m.startswith("panobench.splat.cuda")])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver is there and NVRTC is not."""
    monkeypatch.setattr(backend, "driver_present", lambda: True)
    fine, missing = Finding(True, "NVIDIA driver", "CUDA 13.0"), Finding(False, "NVRTC", "is missing", "install it")
    monkeypatch.setattr(checks, "findings", lambda: iter([fine, missing]))


def test_a_gpu_that_cannot_be_used_is_left_and_one_line_says_why(broken: None) -> None:
    device, note = backend.open_device("auto")
    assert device is None
    assert note == "there is a GPU, but this run uses the CPU: NVRTC: is missing; install it"


def test_a_gpu_that_was_asked_for_must_work(broken: None) -> None:
    with pytest.raises(UnavailableError, match="--device cuda: NVRTC: is missing; install it"):
        backend.open_device("cuda")


def test_findings_end_with_the_first_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_driver", lambda: Finding(True, "driver", ""))
    monkeypatch.setattr(checks, "_torch", lambda: Finding(False, "torch", "is a build without CUDA"))
    monkeypatch.setattr(checks, "_compiler", lambda: pytest.fail("depends on torch"))
    assert [f.what for f in checks.findings()] == ["driver", "torch"]
    assert checks.first_missing() == "torch: is a build without CUDA"


def test_nobody_counts_the_emulators_memory() -> None:
    assert emulated().peak_memory_bytes() is None

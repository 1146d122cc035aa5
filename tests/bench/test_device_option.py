"""--device: who gets the GPU, what the record says of it, and what happens when it is full."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest
from cuda_devices import emulated

from panobench.bench.records.runfolder import LOG, read_run_json
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.errors import UnavailableError, UnknownNameError, UnsupportedError
from panobench.splat import backend

pytestmark = pytest.mark.usefixtures("fake_plugin")


class OutOfMemoryError(RuntimeError):
    """Named as torch names it."""


@pytest.fixture
def user(fake_plugin: Path, monkeypatch: pytest.MonkeyPatch) -> type:
    """The method `still`, which says that it uses a device."""
    still: type = importlib.import_module("fake_plugin").Still  # the module is anew for each test
    monkeypatch.setattr(still, "uses_device", True)
    return still


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A machine whose GPU is the emulator."""
    device = emulated()
    monkeypatch.setattr(device, "peak_memory_bytes", lambda: 3 << 20)
    monkeypatch.setattr(backend, "open_device", lambda choice: (None if choice == "cpu" else device, ""))
    return device


def run(tmp_path: Path, **options: Any) -> tuple[Path, dict[str, Any]]:
    folder = execute(RunRequest(method="fake-still", dataset="tiny", width=64, **options), tmp_path / "run")
    return folder, read_run_json(folder)


@pytest.mark.parametrize("choice", ["auto", "cuda"])
def test_a_method_that_uses_it_gets_the_gpu(user: Any, gpu: Any, tmp_path: Path, choice: str) -> None:
    folder, record = run(tmp_path, device=choice)
    assert record["gpu"] == "emulator"
    assert record["timing"]["peak_gpu_bytes"] == 3 << 20
    assert "maps are computed on the GPU: emulator" in (folder / LOG).read_text()


def test_nobody_else_does(gpu: Any, tmp_path: Path) -> None:
    _, record = run(tmp_path)
    assert "gpu" not in record
    assert "peak_gpu_bytes" not in record["timing"]
    with pytest.raises(UnsupportedError, match="--device cuda: this method computes on the CPU alone"):
        run(tmp_path / "second", device="cuda")


def test_the_cpu_can_be_asked_for(user: Any, gpu: Any, tmp_path: Path) -> None:
    assert "gpu" not in run(tmp_path, device="cpu")[1]


def test_a_gpu_that_cannot_be_used_is_said_and_the_run_goes_on(
    user: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backend, "open_device", lambda _: (None, "there is a GPU, but no NVRTC"))
    folder, record = run(tmp_path)
    assert record["status"] == "ok"
    assert "warning: there is a GPU, but no NVRTC" in (folder / LOG).read_text()


def test_a_gpu_that_is_not_there_is_an_error_if_it_was_asked_for(
    user: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backend, "driver_present", lambda: False)
    with pytest.raises(UnavailableError, match="--device cuda"):
        run(tmp_path, device="cuda")
    assert not (tmp_path / "run").exists()


def test_a_full_gpu_ends_this_run_alone(user: Any, gpu: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def track(self: Any, frame: Any) -> None:
        raise OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(user, "track", track)
    _, record = run(tmp_path)
    assert record["status"] == "out-of-memory"
    assert "CUDA out of memory" in record["message"]


def test_other_devices_do_not_exist() -> None:
    with pytest.raises(UnknownNameError, match="tpu"):
        RunRequest(device="tpu")

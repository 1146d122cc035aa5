"""The devices that the kernels are tested on: the emulator wherever there is g++, and a GPU where there is one."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import pytest
import torch

from panobench.gpu import emulator
from panobench.gpu.device import CudaDevice, Device
from panobench.gpu.emulator import EmulatedDevice, Order
from panobench.splat.backend import driver_present


@functools.cache
def _library() -> Path:
    # The library stays loaded to the end of the process, so the folder may go with it.
    _library.folder = tempfile.TemporaryDirectory()  # type: ignore[attr-defined]
    return emulator.build(Path(_library.folder.name))  # type: ignore[attr-defined]


def emulated(order: Order = "forward", dropped: int = -1) -> EmulatedDevice:
    """The emulator; the test is skipped where there is no compiler for it."""
    if not emulator.available():
        pytest.skip("needs g++")
    return EmulatedDevice(_library(), order, dropped)


def cuda() -> CudaDevice:
    """The GPU; the test is skipped where there is none."""
    if not (driver_present() and torch.cuda.is_available()):
        pytest.skip("needs a GPU")
    return CudaDevice()


DEVICES = {"emulated": emulated, "cuda": cuda}


def open_device(name: str) -> Device | None:
    """A device by the name of a test's parameter; "numba" is the CPU, which has none."""
    return None if name == "numba" else DEVICES[name]()

"""The devices that the kernels are tested on: the emulator wherever there is g++, and a GPU where there is one."""

from __future__ import annotations

import ctypes
import functools
import subprocess
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


class LaunchedByDriver(CudaDevice):
    """``CudaDevice`` with another driver: its library launches kernels on the emulator.

    It shows that kernels get their arguments as CUDA's driver takes them; all the rest of a GPU is missing.
    """

    def __init__(self) -> None:
        Device.__init__(self)
        self.torch_device, self.name = torch.device("cpu"), "driver"
        self._load(ctypes.CDLL(str(_driver())), b"\x7fELF")


_DRIVER = """
#include <string.h>
extern "C" int emulate(const char* name, unsigned blocks, unsigned threads, void** arguments);
extern "C" int cuModuleLoadData(void** module, const void* code) {
    *module = (void*)0x123456789;
    return memcmp(code, "\\x7f" "ELF", 4) ? 200 : 0;
}
extern "C" int cuModuleGetFunction(void** function, void* module, const char* name) {
    if (module != (void*)0x123456789) return 201;
    *function = strdup(name);
    return strcmp(name, "unknown") ? 0 : 500;
}
extern "C" int cuLaunchKernel(void* function, unsigned x, unsigned y, unsigned z, unsigned threads, unsigned ty,
                              unsigned tz, unsigned shared, void* stream, void** arguments, void** extra) {
    if (y != 1 || z != 1 || ty != 1 || tz != 1 || shared || extra || stream != (void*)0x987654321) return 1;
    if (!strcmp((const char*)function, "too_large")) return 2;
    return emulate((const char*)function, x, threads, arguments);
}
extern "C" int cuGetErrorString(int status, const char** text) {
    *text = "named symbol not found";
    return 0;
}
"""


@functools.cache
def _driver() -> Path:
    emulated()
    folder = _library().parent
    (folder / "driver.cpp").write_text(_DRIVER)
    library = folder / "driver.so"
    subprocess.run(
        ["g++", "-shared", "-fPIC", str(folder / "driver.cpp"), str(_library()), "-o", str(library)], check=True
    )
    return library


def open_device(name: str) -> Device | None:
    """A device by the name of a test's parameter; "numba" is the CPU, which has none."""
    return None if name == "numba" else DEVICES[name]()

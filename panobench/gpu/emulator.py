"""The kernels on a CPU, for tests: compiled by g++ behind ``emulator.h``.

It finds what a GPU hides most of the time: a barrier that is missing, or not reached by all threads.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from panobench.gpu.device import Device, packed
from panobench.gpu.errors import DeviceError
from panobench.gpu.source import kernel_names, source

Order = Literal["forward", "reverse", "random"]
_ORDERS: tuple[Order, ...] = ("forward", "reverse", "random")
_HEADER = Path(__file__).parent / "emulator.h"


def available() -> bool:
    """Whether there is a compiler for it."""
    return shutil.which("g++") is not None


def build(folder: Path) -> Path:
    """Compile the kernels into a library in ``folder``. Raises DeviceError with the compiler's words."""
    entries = ", ".join(f'{{"{name}", emulator::entry({name})}}' for name in kernel_names())
    text = f"""#include "{_HEADER}"
namespace {{
{source()}
}}
static const int barriers = __COUNTER__;
static std::map<std::string, emulator::Kernel> kernels = {{{entries}}};
extern "C" int emulate(const char* name, unsigned blocks, unsigned threads, void** arguments) {{
    auto found = kernels.find(name);
    if (found == kernels.end()) return 1;
    return found->second(blocks, threads, arguments) ? 0 : 2;
}}
extern "C" void configure(int order, int dropped) {{ emulator::order = order; emulator::dropped = dropped; }}
extern "C" int barrier_count() {{ return barriers; }}
"""
    folder.mkdir(parents=True, exist_ok=True)
    code, library = folder / "emulated.cpp", folder / "emulated.so"
    code.write_text(text, encoding="utf-8")
    command = ["g++", "-O1", "-std=c++17", "-ffp-contract=off", "-D_FORTIFY_SOURCE=0", "-w", "-shared", "-fPIC"]
    done = subprocess.run([*command, "-o", str(library), str(code)], capture_output=True, text=True)
    if done.returncode:
        raise DeviceError(f"the kernels do not compile for the emulator: {done.stderr[-2000:]}")
    return library


class EmulatedDevice(Device):
    """A device whose blocks run one after another, and their threads in ``order`` between barriers.

    dropped: number of a barrier that is left out, -1 for none.
    """

    def __init__(self, library: Path, order: Order = "forward", dropped: int = -1) -> None:
        super().__init__()
        self.torch_device, self.name = torch.device("cpu"), "emulator"
        self.order, self.dropped = order, dropped
        self._library = ctypes.CDLL(str(library))

    @property
    def barriers(self) -> int:
        """How many barriers the kernels have."""
        return int(self._library.barrier_count())

    def launch(self, kernel: str, blocks: int, threads: int, *arguments: Tensor | float | int | None) -> None:
        if blocks == 0:
            return
        _values, table = packed(arguments)
        self._library.configure(_ORDERS.index(self.order), self.dropped)
        status = self._library.emulate(kernel.encode(), blocks, threads, table)
        if status == 1:
            raise DeviceError(f"there is no kernel '{kernel}'")
        if status:
            raise DeviceError(f"{kernel}: not all threads reach a barrier or an operation of a warp")

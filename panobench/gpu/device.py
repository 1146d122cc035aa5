"""What kernels run on: an interface of one function, and the CUDA driver behind it.

Arrays are torch tensors, which bring memory that is kept between calls, sorting, and prefix sums.
"""

from __future__ import annotations

import ctypes
import weakref
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panobench.gpu import nvrtc
from panobench.gpu.errors import DeviceError

#: CUDA_ERROR_OUT_OF_MEMORY.
_OUT_OF_MEMORY = 2


class UploadedArrays:
    """Arrays of the host that are used again and again, kept on the device while they are alive on the host.

    The arrays must not change meanwhile. What was used longest ago goes when there are more than ``most`` bytes.
    """

    def __init__(self, upload: Callable[[NDArray[Any]], Tensor], most: int = 2 << 30) -> None:
        self.upload, self.most, self.bytes = upload, most, 0
        self._kept: OrderedDict[int, tuple[weakref.ref[Any], Tensor]] = OrderedDict()

    def get(self, array: NDArray[Any]) -> Tensor:
        """The array on the device."""
        found = self._kept.get(id(array))
        if found is not None and found[0]() is array:
            self._kept.move_to_end(id(array))
            return found[1]
        key, tensor = id(array), self.upload(array)
        self._drop(key)
        self._kept[key] = weakref.ref(array, lambda _: self._drop(key)), tensor
        self.bytes += tensor.nbytes
        while self.bytes > self.most and len(self._kept) > 1:
            self._drop(next(iter(self._kept)))
        return tensor

    def _drop(self, key: int) -> None:
        found = self._kept.pop(key, None)
        if found is not None:
            self.bytes -= found[1].nbytes


class Device(ABC):
    """Somewhere to keep tensors and launch kernels. name: what it is, for people."""

    name: str
    torch_device: torch.device

    def __init__(self) -> None:
        self._uploads = UploadedArrays(self.upload)

    @abstractmethod
    def launch(self, kernel: str, blocks: int, threads: int, *arguments: Tensor | float | int | None) -> None:
        """Launch ``kernel`` in a row of blocks; None is a null pointer.

        Raises MemoryError when the device is full, RuntimeError or DeviceError when the kernel cannot be launched.
        """

    def upload(self, array: NDArray[Any], dtype: torch.dtype | None = None) -> Tensor:
        """A copy of an array on the device."""
        # torch warns of arrays that cannot be written, although it only reads this one
        host = np.ascontiguousarray(array) if array.flags.writeable else np.array(array, order="C")
        tensor = torch.from_numpy(host)
        return tensor.to(self.torch_device, dtype=dtype, copy=True)

    def uploaded(self, array: NDArray[Any]) -> Tensor:
        """As ``upload`` for an array that does not change, kept as long as the array lives (``UploadedArrays``)."""
        return self._uploads.get(array)

    def empty(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=self.torch_device)

    def zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(shape, dtype=dtype, device=self.torch_device)

    def peak_memory_bytes(self) -> int | None:
        """The most memory that was in use on the device; None where nobody counts."""
        return None


def download(tensor: Tensor) -> NDArray[Any]:
    """A copy of a tensor on the host."""
    array: NDArray[Any] = tensor.detach().to("cpu", copy=True).numpy()
    return array


def blocks_of(n: int, threads: int = 256) -> int:
    """Blocks that hold n threads."""
    return -(-n // threads)


def packed(arguments: tuple[Tensor | float | int | None, ...]) -> tuple[list[Any], Any]:
    """The arguments as C values, and a table of pointers to these, which must live as long as the table.

    Integers become int, floats float, and NumPy's float64 double.
    """
    values: list[Any] = []
    for a in arguments:
        if isinstance(a, Tensor):
            if not a.is_contiguous():
                raise ValueError("a kernel takes contiguous tensors only")
            values.append(ctypes.c_void_p(a.data_ptr()))
        elif a is None:
            values.append(ctypes.c_void_p(None))
        elif isinstance(a, np.float64):  # a float to Python, too
            values.append(ctypes.c_double(a))
        elif isinstance(a, (int, np.integer)):
            values.append(ctypes.c_int(a))
        else:
            values.append(ctypes.c_float(a))
    return values, (ctypes.c_void_p * len(values))(*[ctypes.addressof(v) for v in values])


class CudaDevice(Device):
    """The current GPU of torch. Raises DeviceError where the kernels cannot be compiled or loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.torch_device = torch.device("cuda", torch.cuda.current_device())
        self.name = torch.cuda.get_device_name(self.torch_device)
        torch.zeros(1, device=self.torch_device)  # makes the context that the module is loaded into
        major, minor = torch.cuda.get_device_capability(self.torch_device)
        self._load(ctypes.CDLL("libcuda.so.1"), nvrtc.compiled(f"sm_{major}{minor}"))

    def _load(self, driver: ctypes.CDLL, code: bytes) -> None:
        """Load compiled kernels by CUDA's driver."""
        self._driver, self._module = driver, ctypes.c_void_p()
        self._functions: dict[str, ctypes.c_void_p] = {}
        self._check(self._driver.cuModuleLoadData(ctypes.byref(self._module), code), "loading the kernels")

    def launch(self, kernel: str, blocks: int, threads: int, *arguments: Tensor | float | int | None) -> None:
        if blocks == 0:
            return
        function = self._functions.get(kernel)
        if function is None:
            function = ctypes.c_void_p()
            found = self._driver.cuModuleGetFunction(ctypes.byref(function), self._module, kernel.encode())
            self._check(found, kernel, RuntimeError)
            self._functions[kernel] = function
        _values, table = packed(arguments)
        stream = ctypes.c_void_p(torch.cuda.current_stream(self.torch_device).cuda_stream)
        status = self._driver.cuLaunchKernel(function, blocks, 1, 1, threads, 1, 1, 0, stream, table, None)
        self._check(status, kernel, RuntimeError)

    def peak_memory_bytes(self) -> int:
        return int(torch.cuda.max_memory_reserved(self.torch_device))

    def _check(self, status: int, what: str, kind: type[Exception] = DeviceError) -> None:
        """Raise MemoryError for a full GPU, and for other errors ``kind``: in mid-run nobody can mend them."""
        if status == _OUT_OF_MEMORY:
            raise MemoryError(f"the GPU ({self.name}) has too little memory for {what}")
        if status:
            text = ctypes.c_char_p()
            self._driver.cuGetErrorString(status, ctypes.byref(text))
            reason = text.value.decode() if text.value else "unknown error"
            raise kind(f"the GPU ({self.name}) failed at {what}: {reason} (CUDA error {status})")

"""What a GPU needs before panobench can use it, each thing checked in one line."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import torch

from panobench.external.findings import Finding
from panobench.gpu import nvrtc
from panobench.gpu.errors import DeviceError

_GIB = float(1 << 30)
#: Least memory, free, of a GPU that is used.
LEAST_BYTES = 2 << 30
_TORCH = "install a build of torch with CUDA: https://pytorch.org/get-started/locally/"


def findings() -> Iterator[Finding]:
    """Driver, torch, compiler, kernels and memory, in this order; it ends with the first that is missing."""
    for check in (_driver, _torch, _compiler, _kernels, _memory):
        found = check()
        yield found
        if not found.ok:
            return


def first_missing() -> str:
    """What is missing and what to do about it, in one line; "" if nothing is."""
    for found in findings():
        if not found.ok:
            return f"{found.what}: {found.detail}" + (f"; {found.fix}" if found.fix else "")
    return ""


def _driver() -> Finding:
    what, fix = "NVIDIA driver", "install NVIDIA's driver: https://www.nvidia.com/drivers"
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return Finding(False, what, "libcuda.so.1 is not installed", fix)
    status, version, count = driver.cuInit(0), ctypes.c_int(), ctypes.c_int()
    if status:
        return Finding(False, what, f"it does not start (CUDA error {status}); see `nvidia-smi`", fix)
    driver.cuDriverGetVersion(ctypes.byref(version))
    driver.cuDeviceGetCount(ctypes.byref(count))
    supports = f"CUDA {version.value // 1000}.{version.value % 1000 // 10}"
    if count.value == 0:
        return Finding(False, what, f"it is there ({supports}) but sees no GPU; see CUDA_VISIBLE_DEVICES")
    return Finding(True, what, f"{supports}, {count.value} GPU{'s' if count.value > 1 else ''}")


def _torch() -> Finding:
    if torch.version.cuda is None:
        return Finding(False, "torch", f"{torch.__version__} is a build without CUDA", _TORCH)
    if not torch.cuda.is_available():
        return Finding(False, "torch", f"its CUDA {torch.version.cuda} does not start with this driver", _TORCH)
    major, minor = torch.cuda.get_device_capability()
    name = torch.cuda.get_device_name()
    return Finding(True, "torch", f"{torch.__version__}, CUDA {torch.version.cuda}; {name} (sm_{major}{minor})")


def _compiler() -> Finding:
    major, minor = torch.cuda.get_device_capability()
    try:
        version, known = nvrtc.version(), nvrtc.architectures()
    except DeviceError as error:
        return Finding(False, "NVRTC", str(error))
    if f"sm_{major}{minor}" not in known:
        return Finding(False, "NVRTC", f"{version} does not compile for sm_{major}{minor}; it knows {', '.join(known)}")
    return Finding(True, "NVRTC", version)


def _kernels() -> Finding:
    from panobench.gpu.device import CudaDevice

    try:
        CudaDevice()
    except DeviceError as error:
        return Finding(False, "kernels", str(error), "update the driver, or install an older NVRTC")
    return Finding(True, "kernels", "compiled and loaded")


def _memory() -> Finding:
    free, total = torch.cuda.mem_get_info()
    detail = f"{free / _GIB:.1f} of {total / _GIB:.1f} GiB are free"
    if free < LEAST_BYTES:
        return Finding(False, "memory", f"{detail}, {LEAST_BYTES / _GIB:.0f} are needed", "end what else uses the GPU")
    return Finding(True, "memory", detail)

"""What draws and optimises maps: the Numba kernels on the CPU, or the CUDA kernels on a device.

A device is None for the CPU everywhere. Whoever has one gives it to ``Renderer`` and to ``TrainableMap``.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

from panobench.errors import UnavailableError, UnsupportedError
from panobench.splat.gaussians import GaussianMap

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.gpu.device import Device
    from panobench.splat.adam import GaussianAdam
    from panobench.splat.cuda.render import DeviceRenderer
    from panobench.splat.view import Projection, View


def driver_present() -> bool:
    """Whether NVIDIA's driver is installed and sees a GPU. Imports nothing and takes no time where there is none."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    count = ctypes.c_int()
    return driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0


def open_device(choice: str) -> tuple[Device | None, str]:
    """The device for --device ``choice``, None for the CPU; and why "auto" did not take the GPU there is, or "".

    Raises UnavailableError for "cuda" where that cannot run.
    """
    if choice == "cpu" or (choice == "auto" and not driver_present()):
        return None, ""
    from panobench.gpu.checks import first_missing
    from panobench.gpu.device import CudaDevice

    try:
        missing = first_missing()
        if missing:
            raise UnavailableError(missing)
        return CudaDevice(), ""
    except UnavailableError as error:
        if choice == "cuda":
            raise UnavailableError(f"--device cuda: {error}") from error
        return None, f"there is a GPU, but this run uses the CPU: {error}"


def renderer_on(device: Device, view: View, low_pass: float, near: float, stop: float) -> DeviceRenderer:
    """What draws ``view`` on a device. Raises UnsupportedError where it cannot."""
    from panobench.splat.cuda.render import DeviceRenderer, why_not

    reason = why_not(view)
    if reason:
        raise UnsupportedError(f"the GPU cannot draw this camera: {reason}; use --device cpu")
    return DeviceRenderer(device, view, low_pass, near, stop)


def device_for(device: Device | None, camera: Camera, projection: Projection) -> Device | None:
    """``device`` if it can draw the camera, else None."""
    if device is None:
        return None
    from panobench.splat.cuda.render import why_not
    from panobench.splat.view import make_view

    return None if why_not(make_view(camera, projection)) else device


def empty_map(device: Device | None) -> GaussianMap:
    """A map without Gaussians, on the device."""
    if device is None:
        return GaussianMap.empty()
    from panobench.splat.cuda.gaussians import DeviceGaussians

    return DeviceGaussians.of(GaussianMap.empty(), device)


def new_adam(n: int, beta1: float, beta2: float, device: Device | None) -> GaussianAdam:
    """An optimiser for n Gaussians on the device."""
    if device is None:
        from panobench.splat.adam import GaussianAdam

        return GaussianAdam(n, beta1, beta2)
    from panobench.splat.cuda.adam import DeviceAdam

    return DeviceAdam(n, beta1, beta2, device)

"""A map whose parameters stay on a device and come to the host when someone looks at them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panobench.gpu.device import Device, download
from panobench.splat.gaussians import GaussianMap

NAMES = ("means", "log_scales", "quats", "opacity_logits", "colours")


class DeviceGaussians(GaussianMap):
    """N Gaussians as tensors (``tensors``, in the order of ``GaussianMap``).

    Its arrays are copies on the host, made on first use after the device last changed the parameters. They are
    read-only: what the host changes goes through ``update`` and ``assign``, as in every map.
    """

    def __init__(self, device: Device, tensors: tuple[Tensor, ...]) -> None:
        self.device, self.tensors = device, tensors

    @classmethod
    def of(cls, gaussians: GaussianMap, device: Device) -> DeviceGaussians:
        """The map on ``device``: itself if it is there, else a copy."""
        if isinstance(gaussians, DeviceGaussians) and gaussians.device is device:
            return gaussians
        return cls(device, tuple(device.upload(a) for a in gaussians.arrays()))

    def __len__(self) -> int:
        return len(self.tensors[0])

    def __getattr__(self, name: str) -> Any:
        if name not in NAMES:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        host = download(self.tensors[NAMES.index(name)])
        host.flags.writeable = False
        self.__dict__[name] = host
        return host

    def changed(self) -> None:
        """The device has changed the parameters: copies on the host are out of date."""
        for name in NAMES:
            self.__dict__.pop(name, None)

    def on_host(self) -> GaussianMap:
        return GaussianMap(*(np.array(a) for a in self.arrays()))

    def copy(self) -> GaussianMap:
        return self.on_host()

    def kept(self, which: NDArray[np.bool_]) -> DeviceGaussians:
        mask = self.device.upload(which)
        return DeviceGaussians(self.device, tuple(t[mask].contiguous() for t in self.tensors))

    def concat(self, other: GaussianMap) -> DeviceGaussians:
        more = DeviceGaussians.of(other, self.device).tensors
        return DeviceGaussians(self.device, tuple(torch.cat([a, b]) for a, b in zip(self.tensors, more)))

    def update(self, **arrays: NDArray[Any]) -> None:
        for name, array in arrays.items():
            tensor = self.tensors[NAMES.index(name)]
            tensor.copy_(torch.from_numpy(np.asarray(array, dtype=np.float32)))
        self.changed()

    def assign(self, which: NDArray[np.bool_], new: GaussianMap) -> None:
        mask = self.device.upload(which)
        for tensor, array in zip(self.tensors, new.arrays()):
            tensor[mask] = self.device.upload(array)
        self.changed()

"""The optimiser of a map on a device: the counterpart of ``GaussianAdam``."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panobench.gpu.device import Device, blocks_of, download
from panobench.kernels.columns import PARAMETERS
from panobench.splat.adam import GaussianAdam, LearningRates, Target
from panobench.splat.cuda.gaussians import DeviceGaussians
from panobench.splat.cuda.render import DeviceRender, chain_blocks
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.render import Render


class DeviceAdam(GaussianAdam):
    """Adam's state as tensors on a device; the arguments of its methods are those of ``GaussianAdam``."""

    def __init__(self, n: int, beta1: float, beta2: float, device: Device) -> None:
        self.beta1, self.beta2, self.device = beta1, beta2, device
        self.moments = (device.zeros(n, PARAMETERS), device.zeros(n, PARAMETERS))
        self.taken = device.zeros(n, dtype=torch.int32)

    def step(
        self,
        gaussians: GaussianMap,
        grads: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> None:
        g, n = self._mine(gaussians), len(gaussians)
        self.device.launch(
            "adam", blocks_of(n), 256, n, *g.tensors, self.device.upload(grads), *self.moments, self.taken,
            self._rates(rates, isotropy, scale_bounds),
        )  # fmt: skip
        g.changed()

    def backward_step(
        self,
        render: Render,
        d_planes: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> NDArray[np.float64]:
        assert isinstance(render, DeviceRender)
        planes = self.device.upload(np.asarray(d_planes, dtype=np.float32))
        pose = self._step_on_device(render, planes, self._rates(rates, isotropy, scale_bounds))
        return download(pose)

    def photometric_step(
        self,
        render: Render,
        target: Target,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> tuple[float, NDArray[np.float64]]:
        """All of it stays on the device but nine numbers. The target's arrays must not change while they are used."""
        assert isinstance(render, DeviceRender)
        image, weights = self.device.uploaded(target.image), self.device.uploaded(target.weights)
        sums, gradient = render.loss_on_device(target, image, weights)
        pose = self._step_on_device(render, gradient, self._rates(rates, isotropy, scale_bounds))
        host = download(torch.cat([sums, pose]))
        return float(host[0]), host[3:]

    def _step_on_device(self, render: DeviceRender, d_planes: Tensor, rates: Tensor) -> Tensor:
        """Differentiate, chain and step; returns dL/dtau (6,)."""
        tape, n = render.tape, len(render.tape.gaussians)
        pose = self.device.zeros(6, dtype=torch.float64)
        sums = render.sums_on_device(d_planes)
        self.device.launch(
            "adam_from_moments", *chain_blocks(n), n, *tape.gaussians.tensors, tape.packed, tape.camera, sums,
            *self.moments, self.taken, rates, pose,
        )  # fmt: skip
        tape.gaussians.changed()
        return pose

    def _mine(self, gaussians: GaussianMap) -> DeviceGaussians:
        if not isinstance(gaussians, DeviceGaussians):
            raise TypeError("a map of the host cannot be optimised on a device: put it there first")
        return gaussians

    def _rates(self, rates: LearningRates, isotropy: float, scale_bounds: tuple[float, float]) -> Tensor:
        """What ``adam.cu`` needs beside the gradients."""
        bounds = np.log(np.array(scale_bounds))
        others = [rates.lift, rates.tilt, isotropy, self.beta1, self.beta2, *bounds]
        return self.device.upload(np.concatenate([rates.per_column(), np.array(others, np.float32)]))

    def extend(self, n: int) -> None:
        m, v = (torch.cat([a, self.device.zeros(n, PARAMETERS)]) for a in self.moments)
        self.moments = (m, v)
        self.taken = torch.cat([self.taken, self.device.zeros(n, dtype=torch.int32)])

    def select(self, keep: NDArray[np.bool_]) -> None:
        mask = self.device.upload(keep)
        m, v = (a[mask].contiguous() for a in self.moments)
        self.moments, self.taken = (m, v), self.taken[mask].contiguous()

"""Fitting a Gaussian map to posed images by gradient steps, each over one view or several.

A step also gathers what densification asks for later: how strongly each Gaussian is pulled across the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.splat.adam import LearningRates
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.loss import photometric_loss
from panobench.splat.render import Gradients, Render, Renderer

Array = NDArray[np.float64]


class TrainingView(Protocol):
    """What a step needs of a view; see ``PosedImage``."""

    image: NDArray[np.uint8]
    T_wc: Array
    gain: float
    offset: float
    weights: F32


@dataclass
class PosedImage:
    """An image (H, W, 3) with its camera-to-world pose. gain, offset: image = exp(gain) render + offset.

    weights (H, W) sum to 1: what each pixel counts.
    """

    index: int
    image: NDArray[np.uint8]
    T_wc: Array
    weights: F32
    gain: float = 0.0
    offset: float = 0.0


@dataclass
class ViewGradient:
    """What one view says: loss, gradients (also of gain and offset) and the render it was computed on."""

    loss: float
    gradients: Gradients
    d_exposure: tuple[float, float]
    render: Render


@dataclass
class GaussianTrainer:
    """Fits a map by joint steps over several views.

    knee: residual below which the loss is quadratic. isotropy: weight of the mean difference of the axes to their mean
    (MonoGS's regulariser). scale_bounds: smallest and largest standard deviation of a Gaussian.
    """

    renderer: Renderer
    map: TrainableMap = field(default_factory=TrainableMap)
    knee: float = 0.0
    isotropy: float = 0.0
    scale_bounds: tuple[float, float] = (1e-5, 1e3)

    @property
    def gaussians(self) -> GaussianMap:
        return self.map.gaussians

    def evaluate(self, view: TrainingView, renderer: Renderer | None = None) -> ViewGradient:
        """Loss and gradients of one view; nothing is changed."""
        renderer = renderer or self.renderer
        out = renderer.forward(self.gaussians, view.T_wc)
        loss, d_planes, d_exposure = photometric_loss(
            out.planes, view.image, view.weights, view.gain, view.offset, self.knee
        )
        return ViewGradient(loss, out.backward(d_planes, planar=True), d_exposure, out.detach())

    def step(
        self, views: Sequence[TrainingView], rates: LearningRates, renderer: Renderer | None = None
    ) -> list[ViewGradient]:
        """One Adam step on the summed losses of ``views``. renderer: another camera's, for smaller images."""
        results, total = [], None
        for view in views:
            result = self.evaluate(view, renderer)
            packed = result.gradients.packed
            self._gather(packed, result.render.order, view.T_wc, renderer or self.renderer)
            total = packed if total is None else total + packed
            results.append(result)
        if total is not None:
            if self.isotropy > 0:
                self._add_isotropy(total)
            self.map.adam.step(self.gaussians, total, rates, 0.0, self.scale_bounds)
        return results

    def _gather(self, packed: F32, order: NDArray[np.int32], T_wc: Array, renderer: Renderer) -> None:
        """The gradient by the image position, from that by the mean: only its part across the viewing ray counts."""
        rays = self.gaussians.means[order] - T_wc[:3, 3].astype(np.float32)
        squared = np.sum(rays * rays, axis=1)
        g = packed[order, :3]
        along = np.sum(g * rays, axis=1)
        across = np.sqrt(np.maximum(np.sum(g * g, axis=1) * squared - along * along, 0.0))
        unit = np.float32(renderer.view.pixel_angle * 0.5 * renderer.view.width)
        touched = across > 0
        self.map.pull[order[touched]] += unit * across[touched]
        self.map.pulls[order[touched]] += 1

    def _add_isotropy(self, total: F32) -> None:
        """Gradient of isotropy x mean |s - mean(s)| by the log-scales."""
        s = np.exp(self.gaussians.log_scales)
        sign = np.sign(s - s.mean(axis=1, keepdims=True))
        total[:, 3:6] += self.isotropy / (3 * len(s)) * (sign - sign.mean(axis=1, keepdims=True)) * s

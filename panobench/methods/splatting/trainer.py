"""A Gaussian map with its optimiser, fitted to posed images by gradient steps.

One step may sum the gradients of several views. While it does, it gathers what densification asks later: how strongly
each Gaussian is pulled across the image (``densify``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3
from panobench.splat.adam import GaussianAdam, LearningRates
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
    """beta2: of Adam. knee: residual below which the loss is quadratic. isotropy: weight of the mean difference of
    the axes to their mean (MonoGS's regulariser). origin (N,): number the Gaussians' maker gave them.

    pull, views (N,): summed length of the gradient across the image, in units of 2 / width, and in how many views.
    """

    renderer: Renderer
    beta2: float = 0.999
    knee: float = 0.0
    isotropy: float = 0.0
    scale_bounds: tuple[float, float] = (1e-5, 1e3)
    map: GaussianMap = field(default_factory=GaussianMap.empty)
    origin: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    pull: F32 = field(default_factory=lambda: np.zeros(0, np.float32))
    views: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))

    def __post_init__(self) -> None:
        self.adam = GaussianAdam(len(self.map), 0.9, self.beta2)

    def __len__(self) -> int:
        return len(self.map)

    def add(self, new: GaussianMap, origin: int | NDArray[np.int32]) -> None:
        """Append Gaussians made by ``origin`` (one number, or one for each)."""
        n = len(new)
        self.map = self.map.concat(new)
        self.adam.extend(n)
        self.origin = np.concatenate([self.origin, np.broadcast_to(np.asarray(origin, np.int32), (n,))])
        self.pull = np.concatenate([self.pull, np.zeros(n, np.float32)])
        self.views = np.concatenate([self.views, np.zeros(n, np.int32)])

    def keep(self, which: NDArray[np.bool_]) -> None:
        """Drop the others."""
        self.map, self.origin = self.map.select(which), self.origin[which]
        self.pull, self.views = self.pull[which], self.views[which]
        self.adam.select(which)

    def evaluate(self, view: TrainingView, renderer: Renderer | None = None) -> ViewGradient:
        """Loss and gradients of one view; nothing is changed."""
        renderer = renderer or self.renderer
        out = renderer.forward(self.map, view.T_wc)
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
            self.adam.step(self.map, total, rates, 0.0, self.scale_bounds)
        return results

    def _gather(self, packed: F32, order: NDArray[np.int32], T_wc: Array, renderer: Renderer) -> None:
        """The gradient by the image position, from that by the mean: only its part across the viewing ray counts."""
        rays = self.map.means[order] - T_wc[:3, 3].astype(np.float32)
        squared = np.sum(rays * rays, axis=1)
        g = packed[order, :3]
        along = np.sum(g * rays, axis=1)
        across = np.sqrt(np.maximum(np.sum(g * g, axis=1) * squared - along * along, 0.0))
        unit = np.float32(renderer.view.pixel_angle * 0.5 * renderer.view.width)
        touched = across > 0
        self.pull[order[touched]] += unit * across[touched]
        self.views[order[touched]] += 1

    def _add_isotropy(self, total: F32) -> None:
        """Gradient of isotropy x mean |s - mean(s)| by the log-scales."""
        s = np.exp(self.map.log_scales)
        sign = np.sign(s - s.mean(axis=1, keepdims=True))
        total[:, 3:6] += self.isotropy / (3 * len(s)) * (sign - sign.mean(axis=1, keepdims=True)) * s

    def move(self, which: NDArray[np.bool_], before: Array, after: Array, scale: float = 1.0) -> None:
        """Let Gaussians follow their camera from pose ``before`` to ``after`` (4, 4); distances grow by ``scale``."""
        R = after[:3, :3] @ before[:3, :3].T
        moved = self.map.select(which).transformed(Sim3(scale, R, after[:3, 3] - scale * R @ before[:3, 3]))
        for mine, new in zip(self.map.arrays(), moved.arrays()):
            mine[which] = new

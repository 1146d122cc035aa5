"""Adam over the Gaussians a view touched, fused with the isotropy term. (Kingma & Ba, 2015.)

Each Gaussian counts its own steps, so one that is seen for the first time gets the bias correction of step one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from panobench.splat.chain import PARAMETERS
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.kernel_options import PARALLEL


@njit(**PARALLEL)
def _adam(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logits, colours, grads, m, v, steps, rates, isotropy, beta1, beta2, scale_min, scale_max
):
    eps = np.float32(1e-15)
    log_beta1, log_beta2 = np.log(beta1), np.log(beta2)
    for k in prange(means.shape[0]):
        g = grads[k]
        size = np.float32(0.0)
        for i in range(14):
            size += abs(g[i])
        if not (size > 0.0 and size < 1e20):  # untouched, or not finite
            continue
        if isotropy > 0.0:
            # Flattened Gaussians are thin on purpose: only the two larger axes are pulled together.
            s0, s1, s2 = np.exp(log_scales[k, 0]), np.exp(log_scales[k, 1]), np.exp(log_scales[k, 2])
            thin = 0 if (s0 <= s1 and s0 <= s2) else (1 if s1 <= s2 else 2)
            a, b = (thin + 1) % 3, (thin + 2) % 3
            sa, sb = np.exp(log_scales[k, a]), np.exp(log_scales[k, b])
            d = np.float32(isotropy) * (np.float32(1.0) if sa > sb else np.float32(-1.0))
            g[3 + a] += d * sa
            g[3 + b] -= d * sb
        steps[k] += 1
        c1, c2 = 1.0 - np.exp(steps[k] * log_beta1), 1.0 - np.exp(steps[k] * log_beta2)
        for i in range(14):
            m[k, i] = beta1 * m[k, i] + (1.0 - beta1) * g[i]
            v[k, i] = beta2 * v[k, i] + (1.0 - beta2) * g[i] * g[i]
            d = np.float32(rates[i] * (m[k, i] / c1) / (np.sqrt(v[k, i] / c2) + eps))
            if i < 3:
                means[k, i] -= d
            elif i < 6:
                log_scales[k, i - 3] = min(max(log_scales[k, i - 3] - d, scale_min), scale_max)
            elif i < 10:
                quats[k, i - 6] -= d
            elif i == 10:
                logits[k] -= d
            else:
                colours[k, i - 11] -= d


@dataclass(frozen=True)
class LearningRates:
    """Step sizes; position is in metres per step, the others in the parameter's own unit."""

    position: float
    log_scale: float = 5e-3
    rotation: float = 1e-3
    opacity: float = 0.05
    colour: float = 2.5e-3

    def per_column(self) -> NDArray[np.float64]:
        """(PARAMETERS,) in the order of the gradient columns."""
        groups = (
            (self.position, 3),
            (self.log_scale, 3),
            (self.rotation, 4),
            (self.opacity, 1),
            (self.colour, 3),
        )
        return np.concatenate([np.full(n, rate) for rate, n in groups])


class GaussianAdam:
    """Optimiser state that grows and shrinks with its map."""

    def __init__(self, n: int, beta1: float = 0.9, beta2: float = 0.999) -> None:
        self.beta1, self.beta2 = beta1, beta2
        self.m, self.v = np.zeros((n, PARAMETERS), np.float32), np.zeros((n, PARAMETERS), np.float32)
        self.steps = np.zeros(n, np.int32)

    def step(
        self,
        gaussians: GaussianMap,
        grads: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> None:
        """Update in place the Gaussians with a non-zero gradient row (N, 14). ``grads`` is used up."""
        low, high = (float(np.log(b)) for b in scale_bounds)
        _adam(
            gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.opacity_logits, gaussians.colours,
            grads, self.m, self.v, self.steps, rates.per_column(), isotropy, self.beta1, self.beta2, low, high,
        )  # fmt: skip

    def extend(self, n: int) -> None:
        """Fresh state for ``n`` Gaussians appended to the map."""
        z = np.zeros((n, PARAMETERS), np.float32)
        self.m, self.v = np.concatenate([self.m, z]), np.concatenate([self.v, z])
        self.steps = np.concatenate([self.steps, np.zeros(n, np.int32)])

    def select(self, keep: NDArray[np.bool_]) -> None:
        """Keep the state of these Gaussians only."""
        self.m, self.v, self.steps = self.m[keep], self.v[keep], self.steps[keep]

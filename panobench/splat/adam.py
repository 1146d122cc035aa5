"""Adam over the Gaussians a view touched, fused with the isotropy term. (Kingma & Ba, 2015.)

Each Gaussian counts its own steps, so one that is seen for the first time gets the bias correction of step one.

Positions and rotations move in the Gaussian's own axes. For a disc lying on a surface, sliding in its plane and
spinning about its normal fit texture; leaving the plane and tilting change depth, which one view cannot tell but
Adam's sign-like steps do anyway, always towards the camera (nearer is larger and in front). Their rates are apart.
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
    means, log_scales, quats, logits, colours, grads, m, v, steps, rates, lift, tilt, isotropy, beta1, beta2,
    scale_min, scale_max,
):  # fmt: skip
    eps = np.float32(1e-15)
    log_beta1, log_beta2 = np.log(beta1), np.log(beta2)
    for k in prange(means.shape[0]):
        g = grads[k]
        size = np.float32(0.0)
        for i in range(14):
            size += abs(g[i])
        if not (size > 0.0 and size < 1e20):  # untouched, or not finite
            continue
        s0, s1, s2 = log_scales[k, 0], log_scales[k, 1], log_scales[k, 2]
        thin = 0 if (s0 <= s1 and s0 <= s2) else (1 if s1 <= s2 else 2)
        if isotropy > 0.0:
            # Flattened Gaussians are thin on purpose: only the two larger axes are pulled together.
            a, b = (thin + 1) % 3, (thin + 2) % 3
            sa, sb = np.exp(log_scales[k, a]), np.exp(log_scales[k, b])
            d = np.float32(isotropy) * (np.float32(1.0) if sa > sb else np.float32(-1.0))
            g[3 + a] += d * sa
            g[3 + b] -= d * sb
        norm = np.sqrt(quats[k, 0] ** 2 + quats[k, 1] ** 2 + quats[k, 2] ** 2 + quats[k, 3] ** 2)
        qw, qx, qy, qz = quats[k, 0] / norm, quats[k, 1] / norm, quats[k, 2] / norm, quats[k, 3] / norm
        r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
        r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
        r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
        gx, gy, gz = g[0], g[1], g[2]
        g[0], g[1], g[2] = (
            r00 * gx + r10 * gy + r20 * gz, r01 * gx + r11 * gy + r21 * gz, r02 * gx + r12 * gy + r22 * gz,
        )  # fmt: skip
        # q (1, w/2) is the rotation by w in the own axes; g is of the unnormalised q.
        a0, a1, a2, a3 = 0.5 * norm * g[6], 0.5 * norm * g[7], 0.5 * norm * g[8], 0.5 * norm * g[9]
        g[6] = -qx * a0 + qw * a1 + qz * a2 - qy * a3
        g[7] = -qy * a0 - qz * a1 + qw * a2 + qx * a3
        g[8] = -qz * a0 + qy * a1 - qx * a2 + qw * a3
        g[9] = 0.0
        dx, dy, dz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        steps[k] += 1
        c1, c2 = 1.0 - np.exp(steps[k] * log_beta1), 1.0 - np.exp(steps[k] * log_beta2)
        for i in range(14):
            m[k, i] = beta1 * m[k, i] + (1.0 - beta1) * g[i]
            v[k, i] = beta2 * v[k, i] + (1.0 - beta2) * g[i] * g[i]
            d = np.float32(rates[i] * (m[k, i] / c1) / (np.sqrt(v[k, i] / c2) + eps))
            if i < 3:
                d *= lift if i == thin else np.float32(1.0)
                dx += d * (r00 if i == 0 else r01 if i == 1 else r02)
                dy += d * (r10 if i == 0 else r11 if i == 1 else r12)
                dz += d * (r20 if i == 0 else r21 if i == 1 else r22)
            elif i < 6:
                log_scales[k, i - 3] = min(max(log_scales[k, i - 3] - d, scale_min), scale_max)
            elif i < 9:
                d *= 0.5 * (tilt if i - 6 != thin else np.float32(1.0))
                wx -= d if i == 6 else 0.0
                wy -= d if i == 7 else 0.0
                wz -= d if i == 8 else 0.0
            elif i == 10:
                logits[k] -= d
            elif i > 10:
                colours[k, i - 11] -= d
        means[k, 0] -= dx
        means[k, 1] -= dy
        means[k, 2] -= dz
        nw, nx = qw - qx * wx - qy * wy - qz * wz, qx + qw * wx + qy * wz - qz * wy
        ny, nz = qy + qw * wy + qz * wx - qx * wz, qz + qw * wz + qx * wy - qy * wx
        norm = np.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3] = nw / norm, nx / norm, ny / norm, nz / norm


@dataclass(frozen=True)
class LearningRates:
    """Step sizes; position is in metres per step, rotation in radians, the others in the parameter's own unit.

    lift, tilt: factors for leaving the plane of the two longer axes, by moving and by turning.
    """

    position: float
    log_scale: float = 5e-3
    rotation: float = 1e-3
    opacity: float = 0.05
    colour: float = 2.5e-3
    lift: float = 1.0
    tilt: float = 1.0

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
            grads, self.m, self.v, self.steps, rates.per_column(),
            rates.lift, rates.tilt, isotropy, self.beta1, self.beta2, low, high,
        )  # fmt: skip

    def extend(self, n: int) -> None:
        """Fresh state for ``n`` Gaussians appended to the map."""
        z = np.zeros((n, PARAMETERS), np.float32)
        self.m, self.v = np.concatenate([self.m, z]), np.concatenate([self.v, z])
        self.steps = np.concatenate([self.steps, np.zeros(n, np.int32)])

    def select(self, keep: NDArray[np.bool_]) -> None:
        """Keep the state of these Gaussians only."""
        self.m, self.v, self.steps = self.m[keep], self.v[keep], self.steps[keep]

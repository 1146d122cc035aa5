"""Adam over the Gaussians a view touched, fused with the isotropy term. (Kingma & Ba, 2015.)

Each Gaussian counts its own steps, so one that is seen for the first time gets the bias correction of step one.

Positions and rotations move in the Gaussian's own axes. For a disc lying on a surface, sliding in its plane and
spinning about its normal fit texture; leaving the plane and tilting change depth, which one view cannot tell but
Adam's sign-like steps do anyway, always towards the camera (nearer is larger and in front). Their rates are apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from panobench.splat.chain import PARAMETERS, gaussian_gradient, sum_moments
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.kernel_options import JIT, MOMENTS, PARALLEL
from panobench.splat.render import Renderer

#: Steps after which the bias correction of either moment is taken to be 1.
_CORRECTED = 4096


@njit(inline="always", **JIT)
def _update(  # type: ignore[no-untyped-def]
    k, g, row, d, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max,
):  # fmt: skip
    """One Adam step of Gaussian k by its gradient g[row] (PARAMETERS,), which is used up; d (PARAMETERS,): scratch."""
    size = np.float32(0.0)
    for i in range(PARAMETERS):
        size += abs(g[row, i])
    if not (size > 0.0 and size < 1e20):  # untouched, or not finite
        return
    s0, s1, s2 = log_scales[k, 0], log_scales[k, 1], log_scales[k, 2]
    thin = 0 if (s0 <= s1 and s0 <= s2) else (1 if s1 <= s2 else 2)
    if isotropy > 0.0:
        # Flattened Gaussians are thin on purpose: only the two larger axes are pulled together.
        a, b = (thin + 1) % 3, (thin + 2) % 3
        sa, sb = np.exp(log_scales[k, a]), np.exp(log_scales[k, b])
        pull = np.float32(isotropy) * (np.float32(1.0) if sa > sb else np.float32(-1.0))
        g[row, 3 + a] += pull * sa
        g[row, 3 + b] -= pull * sb
    norm = np.sqrt(quats[k, 0] ** 2 + quats[k, 1] ** 2 + quats[k, 2] ** 2 + quats[k, 3] ** 2)
    qw, qx, qy, qz = quats[k, 0] / norm, quats[k, 1] / norm, quats[k, 2] / norm, quats[k, 3] / norm
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    gx, gy, gz = g[row, 0], g[row, 1], g[row, 2]
    g[row, 0], g[row, 1], g[row, 2] = (
        r00 * gx + r10 * gy + r20 * gz, r01 * gx + r11 * gy + r21 * gz, r02 * gx + r12 * gy + r22 * gz,
    )  # fmt: skip
    # q (1, w/2) is the rotation by w in the own axes; g is of the unnormalised q.
    a0, a1, a2, a3 = 0.5 * norm * g[row, 6], 0.5 * norm * g[row, 7], 0.5 * norm * g[row, 8], 0.5 * norm * g[row, 9]
    g[row, 6] = -qx * a0 + qw * a1 + qz * a2 - qy * a3
    g[row, 7] = -qy * a0 - qz * a1 + qw * a2 + qx * a3
    g[row, 8] = -qz * a0 + qy * a1 - qx * a2 + qw * a3
    g[row, 9] = 0.0
    n = min(steps[k], len(corrections) - 1)
    steps[k] += 1
    c1, c2 = corrections[n, 0], corrections[n, 1]
    eps = np.float32(1e-15)
    for i in range(PARAMETERS):
        m[k, i] += (np.float32(1) - beta1) * (g[row, i] - m[k, i])
        v[k, i] += (np.float32(1) - beta2) * (g[row, i] * g[row, i] - v[k, i])
        d[i] = rates[i] * (m[k, i] * c1) / (np.sqrt(v[k, i] * c2) + eps)
    d[thin] *= lift
    means[k, 0] -= r00 * d[0] + r01 * d[1] + r02 * d[2]
    means[k, 1] -= r10 * d[0] + r11 * d[1] + r12 * d[2]
    means[k, 2] -= r20 * d[0] + r21 * d[1] + r22 * d[2]
    for i in range(3):
        log_scales[k, i] = min(max(log_scales[k, i] - d[3 + i], scale_min), scale_max)
        d[6 + i] *= np.float32(-0.5) * (tilt if i != thin else np.float32(1.0))
        colours[k, i] -= d[11 + i]
    logits[k] -= d[10]
    wx, wy, wz = d[6], d[7], d[8]
    nw, nx = qw - qx * wx - qy * wy - qz * wz, qx + qw * wx + qy * wz - qz * wy
    ny, nz = qy + qw * wy + qz * wx - qx * wz, qz + qw * wz + qx * wy - qy * wx
    norm = np.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3] = nw / norm, nx / norm, ny / norm, nz / norm


@njit(**PARALLEL)
def _adam(  # type: ignore[no-untyped-def]
    grads, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max, threads,
):  # fmt: skip
    share = (means.shape[0] + threads - 1) // threads
    for th in prange(threads):
        d = np.empty(PARAMETERS, np.float32)
        for k in range(th * share, min((th + 1) * share, means.shape[0])):
            _update(
                k, grads, k, d, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift,
                tilt, isotropy, beta1, beta2, scale_min, scale_max,
            )  # fmt: skip


@njit(**PARALLEL)
def _adam_from_moments(  # type: ignore[no-untyped-def]
    moments, R_cw, t_cw, code, intr, pixel_angle, low_pass, pose,
    means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max,
):  # fmt: skip
    """``parameter_gradients`` and ``_adam`` in one pass: no gradient array is written or read."""
    threads, n = moments.shape[0], means.shape[0]
    share = (n + threads - 1) // threads
    low = low_pass * pixel_angle * pixel_angle
    for th in prange(threads):
        M, tau = np.empty(MOMENTS), np.zeros(6)
        g, d = np.empty((1, PARAMETERS), np.float32), np.empty(PARAMETERS, np.float32)
        for k in range(th * share, min((th + 1) * share, n)):
            if sum_moments(moments, k, M):
                gaussian_gradient(
                    M, k, means, log_scales, quats, logits, R_cw, t_cw, code, intr, low_pass, low, g, 0, tau
                )
                _update(
                    k, g, 0, d, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift,
                    tilt, isotropy, beta1, beta2, scale_min, scale_max,
                )  # fmt: skip
        for i in range(6):
            pose[th, i] = tau[i]


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

    def per_column(self) -> F32:
        """(PARAMETERS,) in the order of the gradient columns."""
        groups = (
            (self.position, 3),
            (self.log_scale, 3),
            (self.rotation, 4),
            (self.opacity, 1),
            (self.colour, 3),
        )
        return np.concatenate([np.full(n, rate, np.float32) for rate, n in groups])


class GaussianAdam:
    """Optimiser state that grows and shrinks with its map."""

    def __init__(self, n: int, beta1: float = 0.9, beta2: float = 0.999) -> None:
        self.beta1, self.beta2 = beta1, beta2
        self.m, self.v = np.zeros((n, PARAMETERS), np.float32), np.zeros((n, PARAMETERS), np.float32)
        self.steps = np.zeros(n, np.int32)
        number = np.arange(1, _CORRECTED + 1)[:, None]
        self._corrections = (1.0 / (1.0 - np.array([beta1, beta2]) ** number)).astype(np.float32)

    def step(
        self,
        gaussians: GaussianMap,
        grads: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> None:
        """Update in place the Gaussians with a non-zero gradient row (N, 14). ``grads`` is used up."""
        _adam(grads, *self._arguments(gaussians, rates, isotropy, scale_bounds), get_num_threads())

    def step_back(
        self,
        renderer: Renderer,
        d_planes: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> NDArray[np.float64]:
        """Backward pass and step in one, for the map the renderer drew last: dL/d(planes) (3, H, W) -> dL/dtau (6,).

        As ``renderer.backward`` and ``step``, to rounding; which Gaussians are touched is what the pass says.
        """
        back = renderer.moments(d_planes)
        pose = np.zeros((len(back.moments), 6))
        _adam_from_moments(
            back.moments, back.R_cw, back.t_cw, back.view.projection, back.view.intrinsics,
            back.view.pixel_angle, renderer.low_pass, pose,
            *self._arguments(back.gaussians, rates, isotropy, scale_bounds),
        )  # fmt: skip
        return pose.sum(axis=0)

    def _arguments(
        self, g: GaussianMap, rates: LearningRates, isotropy: float, scale_bounds: tuple[float, float]
    ) -> tuple[Any, ...]:
        low, high = (np.float32(np.log(b)) for b in scale_bounds)
        return (
            g.means, g.log_scales, g.quats, g.opacity_logits, g.colours,
            self.m, self.v, self.steps, self._corrections, rates.per_column(),
            np.float32(rates.lift), np.float32(rates.tilt), isotropy,
            np.float32(self.beta1), np.float32(self.beta2), low, high,
        )  # fmt: skip

    def extend(self, n: int) -> None:
        """Fresh state for ``n`` Gaussians appended to the map."""
        z = np.zeros((n, PARAMETERS), np.float32)
        self.m, self.v = np.concatenate([self.m, z]), np.concatenate([self.v, z])
        self.steps = np.concatenate([self.steps, np.zeros(n, np.int32)])

    def select(self, keep: NDArray[np.bool_]) -> None:
        """Keep the state of these Gaussians only."""
        self.m, self.v, self.steps = self.m[keep], self.v[keep], self.steps[keep]

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

from panobench.splat.algebra import exp_fast, rotate, rows_of, unrotate
from panobench.splat.block import BLOCK, PARAMETERS, P, channels, load_parameters
from panobench.splat.chain import CHAIN_CHANNELS, G, gradient_block, load_touched
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.kernel_options import INLINE, JIT, PARALLEL
from panobench.splat.render import Render

#: Steps after which the bias correction of either moment is taken to be 1.
_CORRECTED = 4096


# Offsets in a block's buffer behind those of chain.py: moments of the optimiser, their corrections, a flag.
_M = channels(CHAIN_CHANNELS, PARAMETERS)
_V = channels(CHAIN_CHANNELS + PARAMETERS, PARAMETERS)
_C1, _C2, _OK = channels(CHAIN_CHANNELS + 2 * PARAMETERS, 3)
_CHANNELS = CHAIN_CHANNELS + 2 * PARAMETERS + 3
_BLOCK = np.uint64(BLOCK)
_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_EPS, _HUGE = np.float32(1e-15), np.float32(1e20)


@njit(**INLINE)
def _unit_quaternion(buf, j):  # type: ignore[no-untyped-def]
    """(w, x, y, z) and the length it had."""
    w, x, y, z = buf[j + P[6]], buf[j + P[7]], buf[j + P[8]], buf[j + P[9]]
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    inv = _F1 / norm
    return w * inv, x * inv, y * inv, z * inv, norm


@njit(**INLINE)
def _axes(w, x, y, z):  # type: ignore[no-untyped-def]
    """The rows of a unit quaternion's rotation, in float32."""
    return (
        (_F1 - _F2 * (y * y + z * z), _F2 * (x * y - w * z), _F2 * (x * z + w * y)),
        (_F2 * (x * y + w * z), _F1 - _F2 * (x * x + z * z), _F2 * (y * z - w * x)),
        (_F2 * (x * z - w * y), _F2 * (y * z + w * x), _F1 - _F2 * (x * x + y * y)),
    )


@njit(**INLINE)
def _thin(buf, j):  # type: ignore[no-untyped-def]
    """Is the first axis the shortest, is the second (else it is the third)?"""
    s0, s1, s2 = buf[j + P[3]], buf[j + P[4]], buf[j + P[5]]
    first = (s0 <= s1) & (s0 <= s2)
    return first, (not first) & (s1 <= s2)


@njit(**JIT)
def _own_axes(buf, n, isotropy):  # type: ignore[no-untyped-def]
    """Flag the gradients that are to be followed, add the isotropy term, turn what is of space into the own axes."""
    iso = np.float32(isotropy)
    for j in range(n):
        size = _F0
        for i in range(PARAMETERS):
            size += abs(buf[j + G[i]])
        buf[j + _OK] = _F1 if (size > _F0) & (size < _HUGE) else _F0
        # Flattened Gaussians are thin on purpose: only the two larger axes, a and b, are pulled together.
        first, second = _thin(buf, j)
        e0, e1, e2 = exp_fast(buf[j + P[3]]), exp_fast(buf[j + P[4]]), exp_fast(buf[j + P[5]])
        ea, eb = e1 if first else (e2 if second else e0), e2 if first else (e0 if second else e1)
        pull = iso if ea > eb else -iso
        buf[j + G[3]] += _F0 if first else (-pull * e0 if second else pull * e0)
        buf[j + G[4]] += pull * e1 if first else (_F0 if second else -pull * e1)
        buf[j + G[5]] += -pull * e2 if first else (pull * e2 if second else _F0)
        w, x, y, z, norm = _unit_quaternion(buf, j)
        g = unrotate(_axes(w, x, y, z), (buf[j + G[0]], buf[j + G[1]], buf[j + G[2]]))
        # q (1, r/2) is the rotation by r in the own axes; the gradient is of the unnormalised q.
        half = _HALF * norm
        a0, a1, a2, a3 = half * buf[j + G[6]], half * buf[j + G[7]], half * buf[j + G[8]], half * buf[j + G[9]]
        buf[j + G[0]], buf[j + G[1]], buf[j + G[2]] = g
        buf[j + G[6]] = -x * a0 + w * a1 + z * a2 - y * a3
        buf[j + G[7]] = -y * a0 - z * a1 + w * a2 + x * a3
        buf[j + G[8]] = -z * a0 + y * a1 - x * a2 + w * a3
        buf[j + G[9]] = _F0


@njit(**JIT)
def _moments(buf, n, rates, beta1, beta2):  # type: ignore[no-untyped-def]
    """Update the optimiser's moments; gradients become steps."""
    f1, f2 = _F1 - beta1, _F1 - beta2
    for i in range(PARAMETERS):
        rate, at = rates[i], _BLOCK * np.uint64(i)
        for j in range(n):
            g = buf[at + j + G[0]]
            m, v = buf[at + j + _M[0]], buf[at + j + _V[0]]
            m += f1 * (g - m)
            v += f2 * (g * g - v)
            buf[at + j + _M[0]], buf[at + j + _V[0]] = m, v
            buf[at + j + G[0]] = rate * (m * buf[j + _C1]) / (np.sqrt(v * buf[j + _C2]) + _EPS)


@njit(**JIT)
def _move(buf, n, lift, tilt, scale_min, scale_max):  # type: ignore[no-untyped-def]
    """Take the steps."""
    for j in range(n):
        first, second = _thin(buf, j)
        d0 = buf[j + G[0]] * (lift if first else _F1)
        d1 = buf[j + G[1]] * (lift if second else _F1)
        d2 = buf[j + G[2]] * (_F1 if first | second else lift)
        r0 = -_HALF * buf[j + G[6]] * (_F1 if first else tilt)
        r1 = -_HALF * buf[j + G[7]] * (_F1 if second else tilt)
        r2 = -_HALF * buf[j + G[8]] * (tilt if first | second else _F1)
        w, x, y, z, _ = _unit_quaternion(buf, j)
        moved = rotate(_axes(w, x, y, z), (d0, d1, d2))
        buf[j + P[0]] -= moved[0]
        buf[j + P[1]] -= moved[1]
        buf[j + P[2]] -= moved[2]
        buf[j + P[3]] = min(max(buf[j + P[3]] - buf[j + G[3]], scale_min), scale_max)
        buf[j + P[4]] = min(max(buf[j + P[4]] - buf[j + G[4]], scale_min), scale_max)
        buf[j + P[5]] = min(max(buf[j + P[5]] - buf[j + G[5]], scale_min), scale_max)
        nw, nx = w - x * r0 - y * r1 - z * r2, x + w * r0 + y * r2 - z * r1
        ny, nz = y + w * r1 + z * r0 - x * r2, z + w * r2 + x * r1 - y * r0
        inv = _F1 / np.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        buf[j + P[6]], buf[j + P[7]], buf[j + P[8]], buf[j + P[9]] = nw * inv, nx * inv, ny * inv, nz * inv
        buf[j + P[10]] -= buf[j + G[10]]
        buf[j + P[11]] -= buf[j + G[11]]
        buf[j + P[12]] -= buf[j + G[12]]
        buf[j + P[13]] -= buf[j + G[13]]


@njit(**JIT)
def _step_block(  # type: ignore[no-untyped-def]
    buf, ids, count, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max,
):  # fmt: skip
    """One Adam step of the Gaussians whose parameters and gradients are in the buffer, written back to the map."""
    last = len(corrections) - 1
    for j in range(count):
        k = ids[j]
        for i in range(PARAMETERS):
            buf[j + _M[i]], buf[j + _V[i]] = m[k, i], v[k, i]
        done = min(steps[k], last)
        buf[j + _C1], buf[j + _C2] = corrections[done, 0], corrections[done, 1]
    n = np.uint64(count)
    _own_axes(buf, n, isotropy)
    _moments(buf, n, rates, beta1, beta2)
    _move(buf, n, lift, tilt, scale_min, scale_max)
    for j in range(count):
        if buf[j + _OK] == _F0:
            continue
        k = ids[j]
        for i in range(PARAMETERS):
            m[k, i], v[k, i] = buf[j + _M[i]], buf[j + _V[i]]
        for i in range(3):
            means[k, i], log_scales[k, i], colours[k, i] = buf[j + P[i]], buf[j + P[3 + i]], buf[j + P[11 + i]]
        for i in range(4):
            quats[k, i] = buf[j + P[6 + i]]
        logits[k] = buf[j + P[10]]
        steps[k] += 1


@njit(**PARALLEL)
def _adam(  # type: ignore[no-untyped-def]
    grads, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max, threads,
):  # fmt: skip
    count = means.shape[0]
    share = (count + threads - 1) // threads
    for th in prange(threads):
        buf, ids = np.empty(_CHANNELS * BLOCK, np.float32), np.empty(BLOCK, np.int64)
        for k0 in range(th * share, min((th + 1) * share, count), BLOCK):
            n = min(BLOCK, min((th + 1) * share, count) - k0)
            for j in range(n):
                ids[j] = k0 + j
                load_parameters(buf, j, k0 + j, means, log_scales, quats, logits, colours)
                for i in range(PARAMETERS):
                    buf[j + G[i]] = grads[k0 + j, i]
            _step_block(
                buf, ids, n, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift,
                tilt, isotropy, beta1, beta2, scale_min, scale_max,
            )  # fmt: skip


@njit(**PARALLEL)
def _adam_from_moments(  # type: ignore[no-untyped-def]
    moments, R_cw, t_cw, code, intr, pixel_angle, low_pass, pose,
    means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max,
):  # fmt: skip
    """``parameter_gradients`` and ``_adam`` in one pass: no gradient array is written or read."""
    threads, count = moments.shape[0], means.shape[0]
    share = (count + threads - 1) // threads
    low = low_pass * pixel_angle * pixel_angle
    for th in prange(threads):
        buf, ids, tau = np.empty(_CHANNELS * BLOCK, np.float32), np.empty(BLOCK, np.int64), np.zeros(6)
        R, t = rows_of(R_cw), (t_cw[0], t_cw[1], t_cw[2])
        k, end = th * share, min((th + 1) * share, count)
        while k < end:
            n, k = load_touched(buf, ids, k, end, moments, means, log_scales, quats, logits, colours)
            gradient_block(buf, n, R, t, code, intr, low_pass, low, tau)
            _step_block(
                buf, ids, n, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift,
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

    def backward_step(
        self,
        render: Render,
        d_planes: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> NDArray[np.float64]:
        """Backward pass and step in one, of the map ``render`` shows: dL/d(planes) (3, H, W) -> dL/dtau (6,).

        As ``render.backward`` and ``step``, to rounding; which Gaussians are touched is what the pass says.
        """
        moments = render.moments(d_planes)
        pose = np.zeros((len(moments.sums), 6))
        _adam_from_moments(
            moments.sums, moments.R_cw, moments.t_cw, moments.view.projection, moments.view.intrinsics,
            moments.view.pixel_angle, moments.low_pass, pose,
            *self._arguments(moments.gaussians, rates, isotropy, scale_bounds),
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

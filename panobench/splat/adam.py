"""Adam over the Gaussians that a view touched, fused with the isotropy regulariser.

Kingma & Ba, "Adam: a method for stochastic optimization" (2015). Each Gaussian counts its own steps, so that one that
is seen for the first time gets the bias correction of step one.

Positions and rotations move along the Gaussian's own axes. On a disc that lies on a surface, sliding in its plane and
spinning about its normal fit texture. Leaving the plane and tilting change depth, which a single view cannot observe;
Adam's sign-like steps would change it anyway, always towards the camera, because nearer means larger and in front.
These two directions therefore have rates of their own (``lift`` and ``tilt``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from panobench.kernels.block import BLOCK, P, channels, load3, load4, load_parameters, store3, store4
from panobench.kernels.columns import PARAMETERS
from panobench.kernels.fast_math import exp_fast
from panobench.kernels.jit import INLINE, JIT, PARALLEL, njit, prange
from panobench.splat.algebra import rotate, rows_of, unrotate
from panobench.splat.chain import CHAIN_CHANNELS, GRADIENTS, G, gradient_block, load_touched
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.loss import photometric_loss
from panobench.splat.render import Render
from panobench.splat.rig_render import RigRender

#: Steps after which the bias correction of either moment is taken to be 1.
_CORRECTED = 4096


# Offsets in a block's buffer after those of chain.py: Adam's moments, their bias corrections, and whether to step.
_M = channels(CHAIN_CHANNELS, PARAMETERS)
_V = channels(CHAIN_CHANNELS + PARAMETERS, PARAMETERS)
_CORRECT_M, _CORRECT_V, _OK = channels(CHAIN_CHANNELS + 2 * PARAMETERS, 3)
_CHANNELS = CHAIN_CHANNELS + 2 * PARAMETERS + 3
_BLOCK = np.uint64(BLOCK)
_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_EPS, _HUGE = np.float32(1e-15), np.float32(1e20)


@njit(**INLINE)
def _minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**INLINE)
def _unit_quaternion(buf, j):  # type: ignore[no-untyped-def]
    """The quaternion (w, x, y, z) of slot j, normalised, and the length it had."""
    w, x, y, z = load4(buf, j, P.quat)
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    inv = _F1 / norm
    return w * inv, x * inv, y * inv, z * inv, norm


@njit(**INLINE)
def _axes(w, x, y, z):  # type: ignore[no-untyped-def]
    """The rows of a unit quaternion's rotation matrix, in float32."""
    return (
        (_F1 - _F2 * (y * y + z * z), _F2 * (x * y - w * z), _F2 * (x * z + w * y)),
        (_F2 * (x * y + w * z), _F1 - _F2 * (x * x + z * z), _F2 * (y * z - w * x)),
        (_F2 * (x * z - w * y), _F2 * (y * z + w * x), _F1 - _F2 * (x * x + y * y)),
    )


@njit(**INLINE)
def _shortest_axis(buf, j):  # type: ignore[no-untyped-def]
    """Whether the first axis of slot j is its shortest, and whether the second is; otherwise it is the third."""
    s0, s1, s2 = load3(buf, j, P.log_scale)
    first = (s0 <= s1) & (s0 <= s2)
    return first, (not first) & (s1 <= s2)


@njit(**JIT)
def _to_own_axes(buf, n, isotropy):  # type: ignore[no-untyped-def]
    """Flag the gradients that can be followed, add the isotropy term, and rotate gradients into the Gaussian's axes."""
    iso = np.float32(isotropy)
    for j in range(n):
        size = _F0
        for i in range(PARAMETERS):
            size += abs(buf[j + GRADIENTS[i]])
        buf[j + _OK] = _F1 if (size > _F0) & (size < _HUGE) else _F0
        # Flattened Gaussians are thin on purpose: only the two longer axes, a and b, are drawn to equal length.
        first, second = _shortest_axis(buf, j)
        s0, s1, s2 = load3(buf, j, P.log_scale)
        e0, e1, e2 = exp_fast(s0), exp_fast(s1), exp_fast(s2)
        ea, eb = e1 if first else (e2 if second else e0), e2 if first else (e0 if second else e1)
        pull = iso if ea > eb else -iso
        buf[j + G.log_scale[0]] += _F0 if first else (-pull * e0 if second else pull * e0)
        buf[j + G.log_scale[1]] += pull * e1 if first else (_F0 if second else -pull * e1)
        buf[j + G.log_scale[2]] += -pull * e2 if first else (pull * e2 if second else _F0)
        w, x, y, z, norm = _unit_quaternion(buf, j)
        store3(buf, j, G.mean, unrotate(_axes(w, x, y, z), load3(buf, j, G.mean)))
        # q (1, r / 2) is a rotation by the small vector r about the own axes; the gradient is of the unnormalised q.
        half = _HALF * norm
        gw, gx, gy, gz = load4(buf, j, G.quat)
        a0, a1, a2, a3 = half * gw, half * gx, half * gy, half * gz
        buf[j + G.quat[0]] = -x * a0 + w * a1 + z * a2 - y * a3
        buf[j + G.quat[1]] = -y * a0 - z * a1 + w * a2 + x * a3
        buf[j + G.quat[2]] = -z * a0 + y * a1 - x * a2 + w * a3
        buf[j + G.quat[3]] = _F0


@njit(**JIT)
def _moments(buf, n, rates, beta1, beta2):  # type: ignore[no-untyped-def]
    """Update Adam's two moments of every parameter; gradients become steps. rates (PARAMETERS,): step sizes."""
    f1, f2 = _F1 - beta1, _F1 - beta2
    for i in range(PARAMETERS):
        rate, at = rates[i], _BLOCK * np.uint64(i)
        for j in range(n):
            g = buf[at + j + GRADIENTS[0]]
            m, v = buf[at + j + _M[0]], buf[at + j + _V[0]]
            m += f1 * (g - m)
            v += f2 * (g * g - v)
            buf[at + j + _M[0]], buf[at + j + _V[0]] = m, v
            buf[at + j + GRADIENTS[0]] = rate * (m * buf[j + _CORRECT_M]) / (np.sqrt(v * buf[j + _CORRECT_V]) + _EPS)


@njit(**JIT)
def _move(buf, n, lift, tilt, scale_min, scale_max):  # type: ignore[no-untyped-def]
    """Take the steps: positions and rotations in the Gaussian's own axes, the rest directly."""
    for j in range(n):
        first, second = _shortest_axis(buf, j)
        d0 = buf[j + G.mean[0]] * (lift if first else _F1)
        d1 = buf[j + G.mean[1]] * (lift if second else _F1)
        d2 = buf[j + G.mean[2]] * (_F1 if first | second else lift)
        r0 = -_HALF * buf[j + G.quat[0]] * (_F1 if first else tilt)
        r1 = -_HALF * buf[j + G.quat[1]] * (_F1 if second else tilt)
        r2 = -_HALF * buf[j + G.quat[2]] * (tilt if first | second else _F1)
        w, x, y, z, _ = _unit_quaternion(buf, j)
        moved = rotate(_axes(w, x, y, z), (d0, d1, d2))
        store3(buf, j, P.mean, _minus(load3(buf, j, P.mean), moved))
        s0, s1, s2 = _minus(load3(buf, j, P.log_scale), load3(buf, j, G.log_scale))
        buf[j + P.log_scale[0]] = min(max(s0, scale_min), scale_max)
        buf[j + P.log_scale[1]] = min(max(s1, scale_min), scale_max)
        buf[j + P.log_scale[2]] = min(max(s2, scale_min), scale_max)
        store3(buf, j, P.colour, _minus(load3(buf, j, P.colour), load3(buf, j, G.colour)))
        buf[j + P.logit] -= buf[j + G.logit]
        nw, nx = w - x * r0 - y * r1 - z * r2, x + w * r0 + y * r2 - z * r1
        ny, nz = y + w * r1 + z * r0 - x * r2, z + w * r2 + x * r1 - y * r0
        inv = _F1 / np.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
        store4(buf, j, P.quat, (nw * inv, nx * inv, ny * inv, nz * inv))


@njit(**JIT)
def _step_block(  # type: ignore[no-untyped-def]
    buf, ids, count, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max,
):  # fmt: skip
    """One Adam step of the ``count`` Gaussians ``ids`` whose parameters and gradients are in the buffer.

    The results are written to the map's arrays and to m, v (N, PARAMETERS) and steps (N,).
    """
    last = len(corrections) - 1
    for j in range(count):
        k = ids[j]
        for i in range(PARAMETERS):
            buf[j + _M[i]], buf[j + _V[i]] = m[k, i], v[k, i]
        done = min(steps[k], last)
        buf[j + _CORRECT_M], buf[j + _CORRECT_V] = corrections[done, 0], corrections[done, 1]
    n = np.uint64(count)
    _to_own_axes(buf, n, isotropy)
    _moments(buf, n, rates, beta1, beta2)
    _move(buf, n, lift, tilt, scale_min, scale_max)
    for j in range(count):
        if buf[j + _OK] == _F0:
            continue
        k = ids[j]
        for i in range(PARAMETERS):
            m[k, i], v[k, i] = buf[j + _M[i]], buf[j + _V[i]]
        for i in range(3):
            means[k, i], log_scales[k, i] = buf[j + P.mean[i]], buf[j + P.log_scale[i]]
            colours[k, i] = buf[j + P.colour[i]]
        for i in range(4):
            quats[k, i] = buf[j + P.quat[i]]
        logits[k] = buf[j + P.logit]
        steps[k] += 1


@njit(**PARALLEL)
def _adam(  # type: ignore[no-untyped-def]
    grads, means, log_scales, quats, logits, colours, m, v, steps, corrections, rates, lift, tilt, isotropy,
    beta1, beta2, scale_min, scale_max, threads,
):  # fmt: skip
    """One Adam step from gradients (N, PARAMETERS)."""
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
                    buf[j + GRADIENTS[i]] = grads[k0 + j, i]
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
    """``parameter_gradients`` and ``_adam`` in one pass: no array of gradients is written or read."""
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
    """Step sizes: position in the map's unit per step, rotation in radians, the others in the parameter's own unit.

    lift, tilt: factors on the steps that leave the plane of the two longer axes, by moving and by rotating.
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


@dataclass(frozen=True)
class Target:
    """What a render should look like. image (H, W, 3), weights (H, W), gain, offset: as in ``photometric_loss``.

    knee: its ``huber``. opaque: pixels count only where the render's opacity exceeds it; None: everywhere.
    """

    image: NDArray[np.uint8]
    weights: F32
    gain: float = 0.0
    offset: float = 0.0
    knee: float = 0.0
    opaque: float | None = None


class GaussianAdam:
    """Adam's state for a map of N Gaussians; it grows and shrinks with the map.

    m, v (N, PARAMETERS) float32: first and second moments. steps (N,) int32: steps each Gaussian has taken.
    """

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
        """Update ``gaussians`` in place.

        grads (N, PARAMETERS): gradients; Gaussians whose row is zero or not finite stay as they are.
        isotropy: weight of the difference in length of the two longer axes. scale_bounds: standard deviations are
        kept between these, in the map's unit.
        """
        _adam(grads, *self._arguments(gaussians, rates, isotropy, scale_bounds), get_num_threads())

    def backward_step(
        self,
        render: Render,
        d_planes: F32,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> NDArray[np.float64]:
        """Differentiate ``render`` and update the map it shows, in one pass; arguments as in ``step``.

        d_planes (3, H, W): dL/d(colour planes). Returns dL/dtau (6,), see ``Gradients.pose``. Apart from rounding the
        result is that of ``render.backward`` and ``step``.
        """
        if isinstance(render, RigRender):
            found = render.backward(d_planes, planar=True)
            self.step(render.gaussians, found.packed, rates, isotropy, scale_bounds)
            return found.pose
        moments = render.moments(d_planes)
        pose = np.zeros((len(moments.sums), 6))
        _adam_from_moments(
            moments.sums, moments.R_cw, moments.t_cw, moments.view.projection, moments.view.intrinsics,
            moments.view.pixel_angle, moments.low_pass, pose,
            *self._arguments(moments.gaussians, rates, isotropy, scale_bounds),
        )  # fmt: skip
        return pose.sum(axis=0)

    def photometric_step(
        self,
        render: Render,
        target: Target,
        rates: LearningRates,
        isotropy: float = 0.0,
        scale_bounds: tuple[float, float] = (1e-5, 1e3),
    ) -> tuple[float, NDArray[np.float64]]:
        """``backward_step`` along the photometric loss of ``render``; returns the loss and dL/dtau (6,)."""
        weights = target.weights if target.opaque is None else target.weights * (render.opacity > target.opaque)
        loss, gradient, _ = photometric_loss(
            render.planes, target.image, weights, target.gain, target.offset, target.knee
        )
        return loss, self.backward_step(render, gradient, rates, isotropy, scale_bounds)

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
        """Keep the state of the Gaussians that ``keep`` (N,) marks."""
        self.m, self.v = np.compress(keep, self.m, axis=0), np.compress(keep, self.v, axis=0)
        self.steps = np.compress(keep, self.steps)

"""Direct image alignment: the pose of a frame against a reference image with depth, coarse to fine.

This is inverse-compositional Gauss-Newton (Baker & Matthews, "Lucas-Kanade 20 years on", 2004). A point X of the
reference has the residual I_f(pi(T X)) - gain I_r - offset. The Jacobian is that of the reference image, which is the
less noisy one; with the frame's, steps come out too short. Weights are solid angle times Huber's. Damping is
Levenberg-Marquardt's, and a step is kept only if it lowers the mean robust cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise, se3_exp
from panobench.inertial.rotation_prior import RotationPrior
from panobench.photometric.normal_equations import UNKNOWNS, UNSEEN, NormalEquations, normal_equations
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import DEFAULT, AlignOptions, Reference, ReferenceLevel
from panobench.photometric.warp import ERP

if TYPE_CHECKING:
    from panobench.gpu.device import Device

#: Something is moving where more than this share of the view has residuals above ``AlignOptions.cut_moving``.
MOVING_SHARE = 0.05
#: Largest log gain either way: seven stops.
GAIN_MOST = 5.0
#: A rotation prior is weighed as if so many pixels with the residuals' deviation were worth one: neighbours share the
#: errors of the reference.
ALIKE_PIXELS = 100.0


@dataclass
class Alignment:
    """The result of ``align``; figures are of the last level.

    T_fr (4, 4): frame from reference camera. cost: mean robust cost. sigma: robust standard deviation of the residuals,
    of 1. overlap: share of the reference's weight that was seen. iterations: over all levels. hessian (6, 6): over a
    twist (translation, rotation) of the reference camera. gain, offset: frame = exp(gain) reference + offset.
    """

    T_fr: NDArray[np.float64]
    cost: float
    sigma: float
    overlap: float
    iterations: int
    hessian: NDArray[np.float64]
    gain: float = 0.0
    offset: float = 0.0


@dataclass(frozen=True)
class _State:
    """A candidate solution: pose T (4, 4), log gain, offset."""

    T: NDArray[np.float64]
    gain: float
    offset: float

    def moved(self, x: NDArray[np.float64]) -> _State:
        """The state after the step x (6,) or (8,), which moves the reference; the frame moves by its inverse."""
        gain, offset = (self.gain + x[6], self.offset + x[7]) if len(x) > 6 else (self.gain, self.offset)
        gain = float(np.clip(gain, -GAIN_MOST, GAIN_MOST))  # far from a solution the step can be anything
        return _State(self.T @ se3_exp(-x[:6]), gain, offset)


class _HeldRotation:
    """A prior of the frame's rotation beside the residuals of one level, which deviate by ``sigma``."""

    def __init__(self, prior: RotationPrior, level: ReferenceLevel, sigma: float) -> None:
        self.prior, self.total = prior, max(level.total, 1e-12)
        self.by_deviation = ALIKE_PIXELS * sigma**2 * self.total / max(len(level.value), 1)

    def added_to(self, equations: NormalEquations, T_fr: NDArray[np.float64]) -> NormalEquations:
        """The normal equations of both together at the pose ``T_fr`` (4, 4), frame from reference camera."""
        R_rf = T_fr[:3, :3].T  # a step turns it on its left
        information, gradient = self.prior.linearise(R_rf)
        H, b = equations.H.copy(), equations.b.copy()
        H[3:6, 3:6] += self.by_deviation * information * np.eye(3)
        b[3:6] -= self.by_deviation * gradient
        cost = equations.cost + 0.5 * self.by_deviation * self.prior.cost(R_rf) / self.total
        return replace(equations, H=H, b=b, cost=cost)


def align(
    reference: Reference,
    frame: list[F32],
    T_fr: NDArray[np.float64],
    options: AlignOptions = DEFAULT,
    *,
    finest: int = 0,
    coarsest: int | None = None,
    gain: float = 0.0,
    offset: float = 0.0,
    device: Device | None = None,
    prior: RotationPrior | None = None,
) -> Alignment:
    """Align a frame to ``reference``.

    frame: its luma pyramid (H, W) float32 in 0..1, level 0 full size. T_fr (4, 4): pose to start from, frame from
    reference camera. Levels are used from ``coarsest`` (None: the smallest that both have) down to ``finest``. gain,
    offset: of the frame, to start from, or to keep without ``options.exposure``. device: what computes it, None for the
    CPU, which also does what a device cannot: other cameras than panoramas, ``options.exposure``, and ``prior``, of
    the frame's axes in the reference camera's.
    """
    on_device = reference.code == ERP and not options.exposure and min(options.iterations) > 0 and prior is None
    if device is not None and on_device:
        from panobench.photometric.align_device import align_on_device

        return align_on_device(
            device, reference, frame, T_fr, options, finest=finest, coarsest=coarsest, gain=gain, offset=offset
        )
    x = np.zeros(UNKNOWNS if options.exposure else 6)
    free = slice(3 if options.rotation_only else 0, len(x))
    top = min(len(reference.levels), len(frame)) - 1
    first = top if coarsest is None else min(coarsest, top)
    state = _State(renormalise(T_fr), gain, offset)
    count, now = 0, UNSEEN
    for step, level_index in enumerate(range(first, min(finest, first) - 1, -1)):
        level, image = reference.levels[level_index], frame[level_index]

        def evaluate(
            s: _State,
            huber: float,
            cut: float,
            held: _HeldRotation | None,
            level: ReferenceLevel = level,
            image: F32 = image,
        ) -> NormalEquations:
            equations = normal_equations(
                level, image, reference.code, s.T, s.gain, s.offset, huber, cut, exposure=options.exposure
            )
            return equations if held is None else held.added_to(equations, s.T)

        limit = options.iterations[min(step, len(options.iterations) - 1)]
        damping = 1e-4
        before = evaluate(state, 1.0, 10.0, None)
        huber = max(options.huber * before.sigma, options.huber_min)
        cut = options.cut * huber if level_index < options.cut_levels else 10.0
        moving = max(options.cut_moving * huber, options.cut_moving_min)
        if before.above(moving) > MOVING_SHARE:
            cut = min(cut, moving)
        held = None if prior is None else _HeldRotation(prior, level, before.sigma)
        now = evaluate(state, huber, cut, held)
        for _ in range(limit):
            if not np.isfinite(now.cost) or len(level.value) < 50:
                break
            count += 1
            Hf = now.H[free, free]
            diagonal = np.diagonal(Hf)
            A = Hf + np.diag(damping * diagonal + 1e-9 * diagonal.mean())
            try:
                x[free] = np.linalg.solve(A, now.b[free])
            except np.linalg.LinAlgError:
                break
            moved = state.moved(x)
            trial = evaluate(moved, huber, cut, held)
            if trial.cost < now.cost and trial.seen > 0.5 * now.seen:
                state, now = moved, trial
                damping = max(damping * 0.2, 1e-7)
            else:
                damping *= 20
                if damping > 1e3:
                    break
            if np.linalg.norm(x[:3]) < options.step_m and np.linalg.norm(x[3:6]) < options.step_rad:
                break
    return Alignment(
        renormalise(state.T),
        now.cost,
        now.sigma,
        now.seen,
        count,
        now.H[:6, :6],
        state.gain,
        state.offset,
    )


def mean_cost(
    reference: Reference, frame: list[F32], found: Alignment, huber: float, level: int = 0
) -> tuple[float, float]:
    """Mean robust cost of an alignment under a given Huber threshold (of 1), and the share of the weight seen.

    The thresholds of ``align`` follow the residuals, so that its costs cannot be compared with each other; these can.
    """
    level = min(level, len(reference.levels) - 1, len(frame) - 1)
    now = normal_equations(
        reference.levels[level], frame[level], reference.code, found.T_fr, found.gain, found.offset, huber, 10.0
    )
    return now.cost, now.seen

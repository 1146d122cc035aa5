"""Direct image alignment: the pose of a frame against an image with depth, coarse to fine.

Inverse-compositional Gauss-Newton (Baker & Matthews, "Lucas-Kanade 20 years on", 2004) with points X = D s along the
reference rays: residual I_f(pi(T X)) - gain I_r - offset, Jacobian from the reference image (it is the less noisy
one; with the frame's, steps come out too short), weights cos(lat) x Huber, Levenberg-Marquardt damping, and a step
is kept only if the mean robust cost falls.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from panobench.geometry import invert_pose, renormalise, se3_exp
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import DEFAULT, AlignOptions, Reference, ReferenceLevel
from panobench.photometric.warp import dot3, project, sample
from panobench.splat.kernel_options import JIT, PARALLEL

#: Unknowns per step: translation (3), rotation (3), log gain, offset.
UNKNOWNS = 8
_HESSIAN = UNKNOWNS * (UNKNOWNS + 1) // 2
#: Pixels worked together.
_BLOCK = 256
#: Histogram of absolute residuals: bins and their number in one unit of intensity.
_BINS, _PER_BIN = 1024, np.float32(4096)
#: Share of the view that must be off by more than ``AlignOptions.cut_moving`` for something to be moving there.
_MOVING_SHARE = 0.05


@dataclass
class Alignment:
    """T_fr (4, 4): frame from reference camera. cost: mean robust cost; sigma: robust standard deviation of the
    residuals when the last level began; overlap: weight share that was seen.

    hessian (6, 6) at the solution over (translation, rotation) of the reference camera, on the finest level.
    converged: the last level stopped because steps became small. gain, offset: frame = exp(gain) render + offset.
    """

    T_fr: NDArray[np.float64]
    cost: float
    sigma: float
    overlap: float
    iterations: int
    converged: bool
    hessian: NDArray[np.float64]
    gain: float = 0.0
    offset: float = 0.0
    costs: list[float] = field(default_factory=list)


@njit(**PARALLEL)
def _accumulate(points, jacobian, value, weight, image, code, cam, R, t, gain, offset, huber, cut, unknowns, threads):  # type: ignore[no-untyped-def]
    """Per-thread normal equations: (threads, _HESSIAN + UNKNOWNS + 2): H upper triangle, b, cost, weight seen.

    Second result (threads, _BINS): histogram of |residual| in steps of 1 / _PER_BIN.

    Worked in blocks so that all but the sampling runs in vector registers; sums of a block are float32, of blocks
    float64. Only the first ``unknowns`` (6, or 8 with exposure) rows of H and b are filled.
    """
    n = value.shape[0]
    out, bins = np.zeros((threads, _HESSIAN + UNKNOWNS + 2)), np.zeros((threads, _BINS))
    g = np.float32(np.exp(gain))
    off, delta, limit = np.float32(offset), np.float32(huber), np.float32(cut)
    share = (n + threads - 1) // threads
    one = np.ones(_BLOCK, np.float32)
    for th in prange(threads):
        A = np.zeros(_HESSIAN + UNKNOWNS + 2)
        u, v = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
        r, w = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
        J = np.empty((UNKNOWNS, _BLOCK), np.float32)
        last = min((th + 1) * share, n)
        for lo in range(th * share, last, _BLOCK):
            hi = min(lo + _BLOCK, last)
            m = hi - lo
            project(points[0, lo:hi], points[1, lo:hi], points[2, lo:hi], R, t, code, cam, u, v)
            for k in range(m):
                e = sample(image, u[k], v[k], code) - g * value[lo + k] - off
                a, wk = abs(e), weight[lo + k]
                if not (a < 10):  # NaN: masked or outside
                    r[k], w[k] = np.float32(0), np.float32(0)
                    continue
                A[_HESSIAN + UNKNOWNS + 1] += wk
                bins[th, min(int(a * _PER_BIN), _BINS - 1)] += wk
                if a > limit:
                    A[_HESSIAN + UNKNOWNS] += wk * delta * (limit - 0.5 * delta)
                    r[k], w[k] = np.float32(0), np.float32(0)
                    continue
                if a <= delta:
                    A[_HESSIAN + UNKNOWNS] += wk * 0.5 * e * e
                else:
                    A[_HESSIAN + UNKNOWNS] += wk * delta * (a - 0.5 * delta)
                    wk *= delta / a
                r[k], w[k] = e, wk
            for i in range(6):
                for k in range(m):
                    J[i, k] = g * jacobian[i, lo + k]
            if unknowns > 6:
                for k in range(m):
                    J[6, k], J[7, k] = g * value[lo + k], one[k]
            q = 0
            for i in range(UNKNOWNS):
                if i < unknowns:
                    A[_HESSIAN + i] += dot3(w[:m], J[i, :m], r[:m])
                    for j in range(i, unknowns):
                        A[q + j - i] += dot3(w[:m], J[i, :m], J[j, :m])
                q += UNKNOWNS - i
        out[th] = A
    return out, bins


#: The same sums by one thread: waking another costs more than so few pixels.
_accumulate_alone = njit(**JIT)(_accumulate.py_func)
_FEW = 6000


@dataclass(frozen=True)
class _Normal:
    """H (8, 8), b (8,), mean robust cost, share of the weight that was seen and robust residual sigma.

    shares (_BINS,): of the weight seen, up to each bin of the residuals' histogram.
    """

    H: NDArray[np.float64]
    b: NDArray[np.float64]
    cost: float
    seen: float
    sigma: float
    shares: NDArray[np.float64]

    def above(self, residual: float) -> float:
        """Share of the weight seen with larger residuals; 0 beyond what the histogram tells apart."""
        k = residual * float(_PER_BIN)
        return 1.0 - float(self.shares[int(k)]) if k < _BINS - 1 else 0.0


@dataclass(frozen=True)
class _State:
    """A candidate solution: pose, log gain, offset."""

    T: NDArray[np.float64]
    gain: float
    offset: float

    def moved(self, x: NDArray[np.float64]) -> _State:
        """J x ~ r for the reference's own motion x; the frame's motion is its inverse."""
        gain, offset = (self.gain + x[6], self.offset + x[7]) if len(x) > 6 else (self.gain, self.offset)
        return _State(renormalise(self.T @ invert_pose(se3_exp(x[:6]))), gain, offset)


def _normal_equations(
    level: ReferenceLevel, image: F32, code: int, state: _State, huber: float, cut: float, exposure: bool
) -> _Normal:
    threads = get_num_threads()
    R, t = state.T[:3, :3].astype(np.float32), state.T[:3, 3].astype(np.float32)
    accumulate = _accumulate if len(level.value) > _FEW else _accumulate_alone
    parts, bins = accumulate(
        level.points, level.jacobian, level.value, level.weight, image, code, level.camera,
        R, t, state.gain, state.offset, huber, cut, UNKNOWNS if exposure else 6, threads,
    )  # fmt: skip
    sums = parts.sum(axis=0)
    H = np.zeros((UNKNOWNS, UNKNOWNS))
    H[np.triu_indices(UNKNOWNS)] = sums[:_HESSIAN]
    H = H + np.triu(H, 1).T
    seen = float(sums[-1])
    total = level.total
    cost = float(sums[-2]) / seen if seen > 0 else np.inf
    cumulative = np.cumsum(bins.sum(axis=0))
    median = float(np.searchsorted(cumulative, 0.5 * cumulative[-1]) + 0.5) / float(_PER_BIN)
    shares = cumulative / max(cumulative[-1], 1e-12)
    b = sums[_HESSIAN : _HESSIAN + UNKNOWNS]
    return _Normal(H, b, cost, seen / total if total > 0 else 0.0, 1.4826 * median, shares)


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
) -> Alignment:
    """Align a frame (luma pyramid, level 0 full size) to ``reference`` from the start pose ``T_fr``.

    Levels from ``coarsest`` (None: the smallest both have) down to ``finest`` are used in turn.
    """
    x = np.zeros(UNKNOWNS if options.exposure else 6)
    free = np.arange(3 if options.turn_only else 0, len(x))
    top = min(len(reference.levels), len(frame)) - 1
    first = top if coarsest is None else min(coarsest, top)
    state = _State(renormalise(T_fr), gain, offset)
    count, converged, costs = 0, False, []
    now = _Normal(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.inf, 0.0, np.inf, np.ones(_BINS))
    for step, level_index in enumerate(range(first, min(finest, first) - 1, -1)):
        level, image = reference.levels[level_index], frame[level_index]

        def evaluate(s: _State, huber: float, cut: float, level: ReferenceLevel = level, image: F32 = image) -> _Normal:
            return _normal_equations(level, image, reference.code, s, huber, cut, options.exposure)

        limit = options.iterations[min(step, len(options.iterations) - 1)]
        damping, converged = 1e-4, False
        before = evaluate(state, 1.0, 10.0)
        huber = max(options.huber * before.sigma, options.huber_min)
        cut = options.cut * huber if level_index < options.cut_levels else 10.0
        moving = max(options.cut_moving * huber, options.cut_moving_min)
        if before.above(moving) > _MOVING_SHARE:
            cut = min(cut, moving)
        now = evaluate(state, huber, cut)
        for _ in range(limit):
            if not np.isfinite(now.cost) or len(level.value) < 50:
                break
            count += 1
            Hf = now.H[np.ix_(free, free)]
            A = Hf + damping * np.diag(np.diag(Hf)) + 1e-9 * np.trace(Hf) / len(free) * np.eye(len(free))
            try:
                x[free] = np.linalg.solve(A, now.b[free])
            except np.linalg.LinAlgError:
                break
            moved = state.moved(x)
            trial = evaluate(moved, huber, cut)
            if trial.cost < now.cost and trial.seen > 0.5 * now.seen:
                state, now = moved, trial
                damping = max(damping * 0.2, 1e-7)
            else:
                damping *= 20
                if damping > 1e3:
                    converged = True
                    break
            if np.linalg.norm(x[:3]) < options.step_m and np.linalg.norm(x[3:6]) < options.step_rad:
                converged = True
                break
        costs.append(now.cost)
    return Alignment(
        state.T, now.cost, now.sigma, now.seen, count, converged, now.H[:6, :6], state.gain, state.offset, costs
    )


def mean_cost(
    reference: Reference, frame: list[F32], found: Alignment, huber: float, level: int = 0
) -> tuple[float, float]:
    """Mean robust cost of an alignment with a Huber threshold of one's own, and the weight share that was seen.

    Costs of ``align`` have thresholds that follow the residuals and cannot be compared with one another; these can.
    """
    level = min(level, len(reference.levels) - 1, len(frame) - 1)
    state = _State(found.T_fr, found.gain, found.offset)
    now = _normal_equations(reference.levels[level], frame[level], reference.code, state, huber, 10.0, False)
    return now.cost, now.seen

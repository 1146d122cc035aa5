"""Normal equations of a frame against a reference: the inner loop of direct alignment.

Pixels are processed in blocks, and each loop over a block does a single thing, so that all loops are vectorised.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import ReferenceLevel
from panobench.photometric.warp import project, sample_run

#: Unknowns of a step: translation (3), rotation (3), log gain, offset.
UNKNOWNS = 8
#: Pixels in a block.
_BLOCK = 512
#: Histogram of absolute residuals: the number of bins, and of bins in one unit of luma.
_BINS, _PER_BIN = 1024, np.float32(4096)
#: References with fewer pixels are processed by one thread, because waking another costs more.
_FEW = 4000
_F0, _HALF, _OUTSIDE = np.float32(0), np.float32(0.5), np.float32(10)


@njit(**JIT)
def _robust(e, value, weight, g, off, delta, limit, r, w, size):  # type: ignore[no-untyped-def]
    """Samples e (n,) -> residuals r, Huber weights w and absolute residuals size (n,); returns cost and weight seen.

    Samples that are masked or outside are NaN, and get a size of 10. delta: Huber's threshold. Residuals above
    ``limit`` cost what one at the limit does, and have no weight. g, off: gain and offset of the frame.
    """
    cost, seen = _F0, _F0
    worst = delta * (limit - _HALF * delta)
    for k in range(len(e)):
        x = e[k] - g * value[k] - off
        a = abs(x)
        valid = a < _OUTSIDE
        a = a if valid else _OUTSIDE
        wk = weight[k] if valid else _F0
        linear, inside = a > delta, a <= limit
        seen += wk
        cost += wk * ((delta * (a - _HALF * delta) if linear else _HALF * a * a) if inside else worst)
        size[k] = a
        w[k] = (wk * delta / a if linear else wk) if inside else _F0
        r[k] = x if valid else _F0
    return cost, seen


@njit(**JIT)
def _count(size, weight, bins):  # type: ignore[no-untyped-def]
    """Add weights (n,) to the histogram of the absolute residuals ``size`` (n,); the last bin takes all larger ones."""
    for k in range(len(size)):
        if size[k] < _OUTSIDE:
            bins[min(int(size[k] * _PER_BIN), _BINS - 1)] += weight[k]


@njit(**JIT_FINITE)
def add_translation_rows(w, r, J, lo, A, b):  # type: ignore[no-untyped-def]
    """Add rows 0-2 of the upper triangle of sum w J J^T to A (6, 6) and of sum w J r to b (6,).

    w, r (n,): weights and residuals; J (6, ...): Jacobians, those of the pixels from index ``lo`` on.
    """
    h00, h01, h02, h03, h04, h05 = _F0, _F0, _F0, _F0, _F0, _F0
    h11, h12, h13, h14, h15, h22, h23, h24, h25 = _F0, _F0, _F0, _F0, _F0, _F0, _F0, _F0, _F0
    b0, b1, b2 = _F0, _F0, _F0
    for k in range(len(w)):
        j0, j1, j2, j3, j4, j5 = J[0, lo + k], J[1, lo + k], J[2, lo + k], J[3, lo + k], J[4, lo + k], J[5, lo + k]
        w0, w1, w2 = w[k] * j0, w[k] * j1, w[k] * j2
        h00 += w0 * j0
        h01 += w0 * j1
        h02 += w0 * j2
        h03 += w0 * j3
        h04 += w0 * j4
        h05 += w0 * j5
        h11 += w1 * j1
        h12 += w1 * j2
        h13 += w1 * j3
        h14 += w1 * j4
        h15 += w1 * j5
        h22 += w2 * j2
        h23 += w2 * j3
        h24 += w2 * j4
        h25 += w2 * j5
        b0 += w0 * r[k]
        b1 += w1 * r[k]
        b2 += w2 * r[k]
    for i, h in enumerate((h00, h01, h02, h03, h04, h05)):
        A[0, i] += h
    for i, h in enumerate((h11, h12, h13, h14, h15)):
        A[1, 1 + i] += h
    for i, h in enumerate((h22, h23, h24, h25)):
        A[2, 2 + i] += h
    b[0] += b0
    b[1] += b1
    b[2] += b2


@njit(**JIT_FINITE)
def add_rotation_rows(w, r, J, lo, A, b):  # type: ignore[no-untyped-def]
    """Add rows 3-5, see ``add_translation_rows``."""
    h33, h34, h35, h44, h45, h55, b3, b4, b5 = _F0, _F0, _F0, _F0, _F0, _F0, _F0, _F0, _F0
    for k in range(len(w)):
        j3, j4, j5 = J[3, lo + k], J[4, lo + k], J[5, lo + k]
        w3, w4, w5 = w[k] * j3, w[k] * j4, w[k] * j5
        h33 += w3 * j3
        h34 += w3 * j4
        h35 += w3 * j5
        h44 += w4 * j4
        h45 += w4 * j5
        h55 += w5 * j5
        b3 += w3 * r[k]
        b4 += w4 * r[k]
        b5 += w5 * r[k]
    for i, h in enumerate((h33, h34, h35)):
        A[3, 3 + i] += h
    A[4, 4] += h44
    A[4, 5] += h45
    A[5, 5] += h55
    b[3] += b3
    b[4] += b4
    b[5] += b5


@njit(**JIT_FINITE)
def _exposure_columns(w, r, J, value, lo, A, b):  # type: ignore[no-untyped-def]
    """Add columns 6 (gain, whose Jacobian is the reference's value) and 7 (offset, whose Jacobian is 1)."""
    for i in range(6):
        hv, h1 = _F0, _F0
        for k in range(len(w)):
            wj = w[k] * J[i, lo + k]
            hv += wj * value[k]
            h1 += wj
        A[i, 6] += hv
        A[i, 7] += h1
    vv, v1, one, bv, b1 = _F0, _F0, _F0, _F0, _F0
    for k in range(len(w)):
        wv = w[k] * value[k]
        vv += wv * value[k]
        v1 += wv
        one += w[k]
        bv += wv * r[k]
        b1 += w[k] * r[k]
    A[6, 6] += vv
    A[6, 7] += v1
    A[7, 7] += one
    b[6] += bv
    b[7] += b1


@njit(**JIT)
def _sums(  # type: ignore[no-untyped-def]
    first,
    last,
    points,
    jacobian,
    value,
    weight,
    image,
    code,
    cam,
    R,
    t,
    g,
    off,
    huber,
    cut,
    exposure,
    A,
    b,
    totals,
    bins,
):
    """Add pixels first .. last - 1 to A (8, 8), its upper triangle, b (8,), totals (2,) and bins (_BINS,).

    totals: cost and weight seen. The Jacobian is the reference's, not yet multiplied by the gain. Sums over a block are
    float32, over blocks float64.
    """
    u, v, e = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    r, w, size = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    du, dv = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    for lo in range(first, last, _BLOCK):
        hi = min(lo + _BLOCK, last)
        m = hi - lo
        project(points[0, lo:hi], points[1, lo:hi], points[2, lo:hi], R, t, code, cam, u, v)
        sample_run(image, u[:m], v[:m], code, e, du, dv)
        cost, seen = _robust(e[:m], value[lo:hi], weight[lo:hi], g, off, huber, cut, r, w, size)
        totals[0] += cost
        totals[1] += seen
        _count(size[:m], weight[lo:hi], bins)
        add_translation_rows(w[:m], r, jacobian, lo, A, b)
        add_rotation_rows(w[:m], r, jacobian, lo, A, b)
        if exposure:
            _exposure_columns(w[:m], r, jacobian, value[lo:hi], lo, A, b)


@njit(**PARALLEL)
def _sums_shared(  # type: ignore[no-untyped-def]
    threads, points, jacobian, value, weight, image, code, cam, R, t, g, off, huber, cut, exposure, A, b, totals, bins
):
    """``_sums`` by several threads; each has its own entry along the first axis of the last four arrays."""
    share = (len(value) + threads - 1) // threads
    for th in prange(threads):
        _sums(
            th * share, min((th + 1) * share, len(value)), points, jacobian, value, weight, image, code, cam, R, t,
            g, off, huber, cut, exposure, A[th], b[th], totals[th], bins[th],
        )  # fmt: skip


@dataclass(frozen=True)
class NormalEquations:
    """H x = b for the step x (8,) of the reference: translation, rotation, log gain, offset.

    H (8, 8), b (8,). cost: mean robust cost. seen: share of the reference's weight that was seen. bins (_BINS,): weight
    by absolute residual.
    """

    H: NDArray[np.float64]
    b: NDArray[np.float64]
    cost: float
    seen: float
    bins: NDArray[np.float64]

    @cached_property
    def _cumulative(self) -> NDArray[np.float64]:
        return np.cumsum(self.bins)

    @property
    def sigma(self) -> float:
        """Robust standard deviation of the residuals, of 1: 1.4826 times their median absolute value."""
        c = self._cumulative
        return 1.4826 * float(np.searchsorted(c, 0.5 * c[-1]) + 0.5) / float(_PER_BIN)

    def above(self, residual: float) -> float:
        """Share of the weight seen whose residuals are larger; 0 beyond the range of the histogram."""
        k, c = residual * float(_PER_BIN), self._cumulative
        return 1.0 - float(c[int(k)]) / max(float(c[-1]), 1e-12) if k < _BINS - 1 else 0.0


#: Before anything is evaluated.
UNSEEN = NormalEquations(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.inf, 0.0, np.zeros(_BINS))


def normal_equations(
    level: ReferenceLevel,
    image: F32,
    code: int,
    T_fr: NDArray[np.float64],
    gain: float,
    offset: float,
    huber: float,
    cut: float,
    *,
    exposure: bool = False,
) -> NormalEquations:
    """Normal equations of ``image`` (H, W) at the pose ``T_fr`` (4, 4), frame from reference camera.

    The residual is I_f - exp(gain) I_r - offset. huber: Huber's threshold; cut: residuals above it do not count (both
    of 1). Without ``exposure`` only the first six rows of H and b are filled.
    """
    n = len(level.value)
    threads = get_num_threads() if n > _FEW else 1
    A, b = np.zeros((threads, UNKNOWNS, UNKNOWNS)), np.zeros((threads, UNKNOWNS))
    totals, bins = np.zeros((threads, 2)), np.zeros((threads, _BINS))
    T = T_fr.astype(np.float32)
    g = float(np.exp(gain))
    given = (
        level.points, level.jacobian, level.value, level.weight, image, code, level.camera, T[:3, :3], T[:3, 3],
        np.float32(g), np.float32(offset), np.float32(huber), np.float32(cut), exposure,
    )  # fmt: skip
    if threads > 1:
        _sums_shared(threads, *given, A, b, totals, bins)
    else:
        _sums(0, n, *given, A[0], b[0], totals[0], bins[0])
    upper, (cost, seen) = A.sum(axis=0), totals.sum(axis=0)
    scale = np.full(UNKNOWNS, g)
    scale[7] = 1.0
    H = (upper + np.triu(upper, 1).T) * scale * scale[:, None]
    total = level.total
    return NormalEquations(
        H, b.sum(axis=0) * scale, float(cost / seen) if seen > 0 else np.inf, float(seen / total) if total > 0 else 0.0,
        bins.sum(axis=0),
    )  # fmt: skip

"""Blending: compositing of binned footprints, forward and backward. One pair of kernels serves every projection.

Alpha compositing is that of Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering" (2023): a
Gaussian weighs w = alpha T, where T is the transmittance of those before it. ``FootprintColumns`` has the formula of
alpha. On the sphere m is the Gaussian's direction, and p1 and p2 span its whitened tangent plane; first-order
projections have rays r = (u, v, 1) and m = (0, 0, 1).

The inner loops run over the pixels of those rows of a tile that a footprint may reach, as one flat range, without
branches, on one local buffer and with unsigned indices: this lets LLVM vectorise them. In the backward pass alphas
have a loop of their own, because in a single loop the chain from ray to gradient is too long for a core to overlap
its iterations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.columns import MOMENT as M
from panobench.kernels.columns import MOMENTS
from panobench.kernels.jit import INLINE_FINITE, JIT, JIT_FINITE, PARALLEL, njit, prange
from panobench.splat.footprint import ALPHA_MIN, COS_MIN
from panobench.splat.view import TILE_H, TILE_W

#: Alphas are clipped to this, so that no pixel's transmittance becomes zero.
ALPHA_MAX = 0.99
_A_MIN = np.float32(ALPHA_MIN)
_A_MAX = np.float32(ALPHA_MAX)
_COS = np.float32(COS_MIN)
_N = TILE_W * TILE_H
# Offsets of the channels in a tile's local buffer: the ray (x, y, z), the transmittance, then either what is drawn
# (colour, depth) or what comes back (gradients by colour, depth and opacity, what is left of the light).
_CHANNELS = 13
_Y, _Z, _T, _R, _G, _B, _D = (np.uint64(_N * k) for k in range(1, 8))
_GR, _GG, _GB, _GD, _GO, _REM = (np.uint64(_N * k) for k in range(4, 10))
_A, _T1, _T2 = (np.uint64(_N * k) for k in range(10, 13))
_F0, _F1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
# exp(-s / 2) = (cubic in s)^32 for s in [0, 12]; beyond, alpha is below 1/255 whatever the opacity. This is the cubic
# of least relative error: 4e-7, hence 1.3e-5 for the power.
_C0, _C1 = np.float32(0.9999996), np.float32(-0.9999335 / 64)
_C2, _C3 = np.float32(0.49824985 / 64**2), np.float32(-0.15168506 / 64**3)
_S_MAX = np.float32(12.0)


@njit(inline="always", **JIT)
def _load_rays(rays, buf, y0, x0, H, W):  # type: ignore[no-untyped-def]
    """Copy a tile's rays into the local buffer. Pixels beyond the image get a zero ray and never receive colour."""
    for y in range(TILE_H):
        for x in range(TILE_W):
            i = y * TILE_W + x
            if y0 + y < H and x0 + x < W:
                buf[i] = rays[0, y0 + y, x0 + x]
                buf[_N + i] = rays[1, y0 + y, x0 + x]
                buf[2 * _N + i] = rays[2, y0 + y, x0 + x]
            else:
                buf[i] = _F0
                buf[_N + i] = _F0
                buf[2 * _N + i] = _F0


@njit(inline="always", **JIT)
def _wrap_shift(u, x0, wrap):  # type: ignore[no-untyped-def]
    """The multiple of the image width that brings a mean at column u nearest to the tile that begins at x0."""
    if wrap == 0.0:
        return _F0
    return np.float32(wrap * np.round((x0 + 0.5 * TILE_W - u) / wrap))


@njit(**INLINE_FINITE)
def _offset(p, p1z, p2z, buf, i):  # type: ignore[no-untyped-def]
    """Whitened offset t of pixel i from footprint p, and |t|^2, which is _S_MAX beyond the largest angle."""
    x, y, z = buf[i], buf[i + _Y], buf[i + _Z]
    n0 = p[F.m[0]] * x + p[F.m[1]] * y + p[F.m[2]] * z
    inv = _F1 / max(n0, _COS)
    t1 = (p[F.p1[0]] * x + p[F.p1[1]] * y + p1z * z) * inv
    t2 = (p[F.p2[0]] * x + p[F.p2[1]] * y + p2z * z) * inv
    return t1, t2, t1 * t1 + t2 * t2 if n0 > _COS else _S_MAX


@njit(**INLINE_FINITE)
def _exp_half(s):  # type: ignore[no-untyped-def]
    """exp(-s / 2); for s beyond _S_MAX its value there."""
    s = min(s, _S_MAX)
    e = (_C0 + _C1 * s) + (s * s) * (_C2 + _C3 * s)
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    return e * e


def _forward_span_of(count: bool) -> Callable[..., None]:
    """A kernel that draws one footprint over n pixels from lo.

    count: it adds to touched[th, k] how many of them the footprint touches while more than half of the light still
    passes, and to weights[th, k] the sum of its weights.
    """

    @njit(**JIT_FINITE)
    def span(p, p1z, p2z, buf, lo, n, touched, weights, th, k):  # type: ignore[no-untyped-def]
        o, q_cut = p[F.opacity], p[F.cut]
        cr, cg, cb, cd = p[F.colour[0]], p[F.colour[1]], p[F.colour[2]], p[F.distance]
        d1, d2 = p[F.slope[0]], p[F.slope[1]]
        total, hits = _F0, _F0
        for j in range(n):
            i = lo + j
            t1, t2, square = _offset(p, p1z, p2z, buf, i)
            a = min(o * _exp_half(square), _A_MAX)
            T = buf[i + _T]
            w = a * T if a >= _A_MIN else _F0
            buf[i + _R] += w * cr
            buf[i + _G] += w * cg
            buf[i + _B] += w * cb
            buf[i + _D] += w * (cd + d1 * t1 + d2 * t2)
            buf[i + _T] = T - w
            if count:
                total += w
                hits += _F1 if (square <= q_cut) & (T > _HALF) else _F0
        if count:
            weights[th, k] += total
            touched[th, k] += np.int32(hits)

    return span


_forward_span, _forward_span_counted = _forward_span_of(False), _forward_span_of(True)


@njit(**PARALLEL)
def blend_forward(  # type: ignore[no-untyped-def]
    footprints, starts, entries, spans, rays, wrap, stop, tiles, threads, colour, depth, opacity, done, touched, weights
):
    """Composite tiles front to back.

    footprints (M, FOOTPRINT_COLUMNS) float32: in order of depth. starts (tiles + 1,), entries (E,), spans (E, 2): as
    from ``bin_tiles``. rays (3, H, W): the view's. wrap: width of a panorama whose columns repeat, else 0. stop: a
    tile is finished when no pixel's transmittance exceeds this. tiles (K,) int32: the tiles to draw.

    Writes colour (3, H, W), depth (H, W) = sum of w dist, opacity (H, W) = sum of w, and done (tiles,), the number of
    entries used. Where these have M columns, and not none, it adds to touched (threads, M) int32 the pixels that a
    footprint touches while more than half of the light still passes, and to weights (threads, M) float32 the sum of w.
    """
    H, W = rays.shape[1], rays.shape[2]
    tiles_x = (W + TILE_W - 1) // TILE_W
    count = touched.shape[1] > 0
    for th in prange(threads):
        buf = np.empty(_CHANNELS * _N, np.float32)
        for ti in range(th, len(tiles), threads):
            tile = tiles[ti]
            y0, x0 = (tile // tiles_x) * TILE_H, (tile % tiles_x) * TILE_W
            y1, x1 = min(y0 + TILE_H, H), min(x0 + TILE_W, W)
            _load_rays(rays, buf, y0, x0, H, W)
            for i in range(_N):
                buf[3 * _N + i] = _F1
            for i in range(4 * _N, 8 * _N):
                buf[i] = _F0
            used = 0
            for e in range(starts[tile], starts[tile + 1]):
                k = entries[e]
                used += 1
                p = footprints[k]
                shift = _wrap_shift(p[F.u], x0, wrap)
                p1z, p2z = p[F.p1[2]] - p[F.p1[0]] * shift, p[F.p2[2]] - p[F.p2[0]] * shift
                lo, n = np.uint64(spans[e, 0] * TILE_W), np.uint64(spans[e, 1] * TILE_W)
                if count:
                    _forward_span_counted(p, p1z, p2z, buf, lo, n, touched, weights, th, k)
                else:
                    _forward_span(p, p1z, p2z, buf, lo, n, touched, weights, th, k)
                if used % 32 == 0:
                    top = _F0
                    for y in range(y1 - y0):
                        for x in range(x1 - x0):
                            top = max(top, buf[3 * _N + y * TILE_W + x])
                    if top < stop:
                        break
            done[tile] = used
            for y in range(y1 - y0):
                for x in range(x1 - x0):
                    i = y * TILE_W + x
                    colour[0, y0 + y, x0 + x] = buf[4 * _N + i]
                    colour[1, y0 + y, x0 + x] = buf[5 * _N + i]
                    colour[2, y0 + y, x0 + x] = buf[6 * _N + i]
                    depth[y0 + y, x0 + x] = buf[7 * _N + i]
                    opacity[y0 + y, x0 + x] = _F1 - buf[3 * _N + i]


@njit(inline="always", **JIT_FINITE)
def _alpha_span(p, p1z, p2z, buf, lo, n):  # type: ignore[no-untyped-def]
    """Alpha and t of footprint p at n pixels from lo; alpha is 0 where it is cut, and not yet clipped to ALPHA_MAX."""
    o = p[F.opacity]
    for j in range(n):
        i = lo + j
        t1, t2, square = _offset(p, p1z, p2z, buf, i)
        a = o * _exp_half(square)
        buf[i + _A] = a if a >= _A_MIN else _F0
        buf[i + _T1] = t1
        buf[i + _T2] = t2


def _backward_span_of(deep: bool) -> Callable[..., None]:
    """The backward pass over n pixels from lo; ``deep``: with dL/d(depth) and dL/d(opacity), which mapping lacks."""

    @njit(**JIT_FINITE)
    def span(p, p1z, p2z, buf, lo, n, out, th, k):  # type: ignore[no-untyped-def]
        _alpha_span(p, p1z, p2z, buf, lo, n)
        cr, cg, cb, cd = p[F.colour[0]], p[F.colour[1]], p[F.colour[2]], p[F.distance]
        s0, s1, s2, s11, s12, s22 = _F0, _F0, _F0, _F0, _F0, _F0
        s31, s32, gr, gg, gb, gd = _F0, _F0, _F0, _F0, _F0, _F0
        for j in range(n):
            i = lo + j
            raw, t1, t2, T = buf[i + _A], buf[i + _T1], buf[i + _T2], buf[i + _T]
            a = min(raw, _A_MAX)
            w = a * T
            dr, dg, db = buf[i + _GR], buf[i + _GG], buf[i + _GB]
            gc = dr * cr + dg * cg + db * cb
            if deep:
                dd = buf[i + _GD]
                gc += dd * cd + buf[i + _GO]
                gd += w * dd
            rem = buf[i + _REM] - w * gc
            buf[i + _REM] = rem
            buf[i + _T] = T - w
            # dL/dalpha = T gc - (light from behind) / (1 - alpha); times alpha it is dL/d(exponent), 0 where clipped.
            g = a * (T * gc - rem / (_F1 - a))
            g = g if raw < _A_MAX else _F0
            g1, g2 = g * t1, g * t2
            g3 = g * (t1 * t1 + t2 * t2)
            s0 += g
            s1 += g1
            s2 += g2
            s11 += g1 * t1
            s12 += g1 * t2
            s22 += g2 * t2
            s31 += g3 * t1
            s32 += g3 * t2
            gr += w * dr
            gg += w * dg
            gb += w * db
        out[th, k, M.g] += s0
        out[th, k, M.gt[0]] += s1
        out[th, k, M.gt[1]] += s2
        out[th, k, M.gtt[0]] += s11
        out[th, k, M.gtt[1]] += s12
        out[th, k, M.gtt[2]] += s22
        out[th, k, M.gttt[0]] += s31
        out[th, k, M.gttt[1]] += s32
        out[th, k, M.colour[0]] += gr
        out[th, k, M.colour[1]] += gg
        out[th, k, M.colour[2]] += gb
        out[th, k, M.distance] += gd

    return span


_backward_span, _backward_span_deep = _backward_span_of(False), _backward_span_of(True)


@njit(**PARALLEL)
def blend_backward(  # type: ignore[no-untyped-def]
    footprints, order, starts, entries, spans, rays, wrap, tiles, threads, colour, depth, opacity, done,
    d_colour, d_depth, d_opacity, moments,
):  # fmt: skip
    """Gradients, as sums over pixels for each Gaussian: footprint k is Gaussian order[k].

    d_colour (3, H, W), d_depth (H, W), d_opacity (H, W): dL/d(output); the last two may be (0, 0). The other arguments
    are those that ``blend_forward`` got and wrote. moments (threads, N, MOMENTS) float32, see ``MomentColumns``, are
    added to.

    The light from behind a footprint is what is left of the composited total after subtracting what lies in front, so
    that nothing is divided by a vanishing transmittance.
    """
    H, W = rays.shape[1], rays.shape[2]
    tiles_x = (W + TILE_W - 1) // TILE_W
    with_depth, with_opacity = d_depth.shape[0] > 0, d_opacity.shape[0] > 0
    for th in prange(threads):
        buf = np.empty(_CHANNELS * _N, np.float32)
        for ti in range(th, len(tiles), threads):
            tile = tiles[ti]
            y0, x0 = (tile // tiles_x) * TILE_H, (tile % tiles_x) * TILE_W
            y1 = min(y0 + TILE_H, H)
            _load_rays(rays, buf, y0, x0, H, W)
            for i in range(_N):
                buf[3 * _N + i] = _F1
            for i in range(4 * _N, 10 * _N):
                buf[i] = _F0
            for y in range(y1 - y0):
                for x in range(min(TILE_W, W - x0)):
                    i, v, u = y * TILE_W + x, y0 + y, x0 + x
                    total = _F0
                    for c in range(3):
                        buf[(4 + c) * _N + i] = d_colour[c, v, u]
                        total += d_colour[c, v, u] * colour[c, v, u]
                    if with_depth:
                        buf[7 * _N + i] = d_depth[v, u]
                        total += d_depth[v, u] * depth[v, u]
                    if with_opacity:
                        buf[8 * _N + i] = d_opacity[v, u]
                        total += d_opacity[v, u] * opacity[v, u]
                    buf[9 * _N + i] = total
            for e in range(starts[tile], starts[tile] + done[tile]):
                k = entries[e]
                p = footprints[k]
                shift = _wrap_shift(p[F.u], x0, wrap)
                p1z, p2z = p[F.p1[2]] - p[F.p1[0]] * shift, p[F.p2[2]] - p[F.p2[0]] * shift
                lo, n = np.uint64(spans[e, 0] * TILE_W), np.uint64(spans[e, 1] * TILE_W)
                if with_depth or with_opacity:
                    _backward_span_deep(p, p1z, p2z, buf, lo, n, moments, th, order[k])
                else:
                    _backward_span(p, p1z, p2z, buf, lo, n, moments, th, order[k])


def new_moments(threads: int, gaussians: int) -> np.ndarray:
    """Zeros (threads, gaussians, MOMENTS) for ``blend_backward`` to add to."""
    return np.zeros((threads, gaussians, MOMENTS), np.float32)

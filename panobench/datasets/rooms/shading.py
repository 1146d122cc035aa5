"""Radiance of a hit and whole frames: anisotropic texture filtering, baked light, one mirror ray, edge coverage.

Anti-aliasing: visibility is sampled ``sub`` x ``sub`` times per pixel; every surface seen in a pixel is shaded once,
with its texture averaged over the pixel's footprint (mip maps, up to eight taps along the longer axis), and weighted by
the share of samples that see it. Averaging happens after the tone curve, so that bright lamps keep smooth edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from panobench.datasets.rooms.bake import node_light
from panobench.datasets.rooms.trace import trace
from panobench.datasets.rooms.visibility import (
    COARSE_H,
    COARSE_W,
    FINE_H,
    FINE_W,
    candidates,
    edge_functions,
    nearest,
)

MAX_TAPS = 8
FAST = {"contract", "nsz", "reassoc", "arcp"}


@njit(nogil=True, cache=True, fastmath=FAST, inline="always")
def _texel(texels: Any, first: int, lw: int, lh: int, x: float, y: float) -> tuple[float, float, float]:
    """Bilinear look-up in one mip level; x, y in texels, wrapping."""
    xf, yf = np.floor(x - 0.5), np.floor(y - 0.5)
    fx, fy = x - 0.5 - xf, y - 0.5 - yf
    mx, my = (1 << lw) - 1, (1 << lh) - 1
    x0, y0 = int(xf) & mx, int(yf) & my
    x1, y1 = (x0 + 1) & mx, (y0 + 1) & my
    a, b = first + (y0 << lw), first + (y1 << lw)
    w00, w10, w01, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    r, g, bl = 0.0, 0.0, 0.0
    c = float(texels[a + x0, 0])
    r += w00 * c * c
    c = float(texels[a + x1, 0])
    r += w10 * c * c
    c = float(texels[b + x0, 0])
    r += w01 * c * c
    c = float(texels[b + x1, 0])
    r += w11 * c * c
    c = float(texels[a + x0, 1])
    g += w00 * c * c
    c = float(texels[a + x1, 1])
    g += w10 * c * c
    c = float(texels[b + x0, 1])
    g += w01 * c * c
    c = float(texels[b + x1, 1])
    g += w11 * c * c
    c = float(texels[a + x0, 2])
    bl += w00 * c * c
    c = float(texels[a + x1, 2])
    bl += w10 * c * c
    c = float(texels[b + x0, 2])
    bl += w01 * c * c
    c = float(texels[b + x1, 2])
    bl += w11 * c * c
    k = 1.0 / 65025.0
    return r * k, g * k, bl * k


@njit(nogil=True, cache=True, fastmath=FAST)
def _filtered(
    texels: Any,
    table: Any,
    t: int,
    s: float,
    r: float,
    sx: float,
    rx: float,
    sy: float,
    ry: float,
    taps: int,
) -> tuple[float, float, float]:
    """Texture t at (s, r) averaged over the parallelogram (sx, rx), (sy, ry); all in repeats."""
    first, lw, lh = table[t, 0], table[t, 1], table[t, 2]
    if lw == 0 and lh == 0:
        return _texel(texels, first, 0, 0, 0.5, 0.5)
    W, H = float(1 << lw), float(1 << lh)
    ax, ay, bx, by = sx * W, rx * H, sy * W, ry * H
    p, q, c = ax * ax + bx * bx, ay * ay + by * by, ax * ay + bx * by
    mid, dif = 0.5 * (p + q), 0.5 * (p - q)
    root = np.sqrt(dif * dif + c * c)
    major, minor = np.sqrt(max(mid + root, 1e-12)), np.sqrt(max(mid - root, 0.0))
    n = min(taps, max(1, int(np.ceil(major / max(minor, 1.0) - 0.05))))
    if dif >= 0:
        ux, uy = dif + root, c
    else:
        ux, uy = c, root - dif
    length = np.sqrt(ux * ux + uy * uy)
    if length > 1e-12:
        ux, uy = ux / length, uy / length
    else:
        ux, uy = 1.0, 0.0
    lod = np.log2(max(max(minor, major / n), 1.0))
    top = max(lw, lh)
    lod = min(lod, float(top) - 1e-3)
    level = int(lod)
    f = lod - level
    r0, g0, b0, r1, g1, b1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # Levels halve both sides until one of them is 1; textures have at most a ratio of a few.
    l0w, l0h, at = lw, lh, first
    for _ in range(level):
        at += 1 << (l0w + l0h)
        l0w, l0h = max(l0w - 1, 0), max(l0h - 1, 0)
    l1w, l1h, at1 = max(l0w - 1, 0), max(l0h - 1, 0), at + (1 << (l0w + l0h))
    for k in range(n):
        o = ((k + 0.5) / n - 0.5) * major
        x, y = s * W + o * ux, r * H + o * uy
        i0, i1 = 1.0 / (1 << (lw - l0w)), 1.0 / (1 << (lh - l0h))
        a, b, d = _texel(texels, at, l0w, l0h, x * i0, y * i1)
        r0, g0, b0 = r0 + a, g0 + b, b0 + d
        if f > 0.02:
            i0, i1 = 1.0 / (1 << (lw - l1w)), 1.0 / (1 << (lh - l1h))
            a, b, d = _texel(texels, at1, l1w, l1h, x * i0, y * i1)
            r1, g1, b1 = r1 + a, g1 + b, b1 + d
    if f <= 0.02:
        return r0 / n, g0 / n, b0 / n
    return (r0 + f * (r1 - r0)) / n, (g0 + f * (g1 - g0)) / n, (b0 + f * (b1 - b0)) / n


@njit(nogil=True, cache=True, fastmath=FAST)
def _surface(
    i: int,
    u: float,
    v: float,
    ux: float,
    vx: float,
    uy: float,
    vy: float,
    look: Any,
    uv: Any,
    tint: Any,
    macro: Any,
    glow: Any,
    texels: Any,
    table: Any,
    light: Any,
    taps: int,
) -> tuple[float, float, float]:
    """Diffuse or emitted radiance of primitive i at (u, v) with footprint d(u, v)/dx, d(u, v)/dy."""
    s = uv[i, 0] + u * uv[i, 1] + v * uv[i, 2]
    t = uv[i, 3] + u * uv[i, 4] + v * uv[i, 5]
    sx, tx = ux * uv[i, 1] + vx * uv[i, 2], ux * uv[i, 4] + vx * uv[i, 5]
    sy, ty = uy * uv[i, 1] + vy * uv[i, 2], uy * uv[i, 4] + vy * uv[i, 5]
    r, g, b = _filtered(texels, table, look[i, 0], s, t, sx, tx, sy, ty, taps)
    if glow[i, 0] > 0 or glow[i, 1] > 0 or glow[i, 2] > 0:
        return r * glow[i, 0], g * glow[i, 1], b * glow[i, 2]
    if look[i, 1] >= 0:
        # Turned and at an odd ratio, so that no two repeats of the base texture look the same.
        k = 0.37
        ms, mt = k * (0.8 * s + 0.6 * t), k * (0.8 * t - 0.6 * s)
        m, _, _ = _filtered(texels, table, look[i, 1], ms, mt, k * sx, k * tx, k * sy, k * ty, 1)
        f = 1.0 + macro[i] * (2.0 * m - 1.0)
        r, g, b = r * f, g * f, b * f
    r *= tint[i, 0] * node_light(look, light, i, u, v, 0)
    g *= tint[i, 1] * node_light(look, light, i, u, v, 1)
    b *= tint[i, 2] * node_light(look, light, i, u, v, 2)
    return r, g, b


@njit(nogil=True, cache=True, fastmath=FAST, inline="always")
def tone(x: float, gain: float) -> float:
    """Display-linear 0..1: straight up to 0.6, then an exponential shoulder with the same slope."""
    x = x * gain
    return x if x < 0.6 else 0.6 + 0.4 * (1.0 - np.exp((0.6 - x) * 2.5))


@njit(nogil=True, cache=True, fastmath=FAST)
def render_frame(
    R_wc: Any,
    centre: Any,
    rays: Any,
    ray_x: Any,
    ray_y: Any,
    coarse: Any,
    fine: Any,
    sub: int,
    gain: float,
    p0: Any,
    dual_u: Any,
    dual_v: Any,
    normal: Any,
    two_sided: Any,
    shape: Any,
    group: Any,
    look: Any,
    uv: Any,
    tint: Any,
    coat: Any,
    macro: Any,
    glow: Any,
    texels: Any,
    table: Any,
    light: Any,
    boxes: Any,
    links: Any,
    planes: Any,
    tree_shape: Any,
    order: Any,
    out: Any,
) -> None:
    """Add one frame's display-linear RGB to ``out`` (H, W, 3) float32.

    rays (H, W, 3) float32 in the camera frame, zero where the camera sees nothing; ray_x, ray_y: their derivatives
    per pixel; coarse, fine: tile cones.
    """
    H, W = rays.shape[0], rays.shape[1]
    n_prims = p0.shape[0]
    f = np.empty((n_prims, 9), np.float32)
    index = np.empty(n_prims, np.int32)
    count = edge_functions(p0, dual_u, dual_v, normal, two_sided, R_wc, centre, f, index)
    every = np.arange(count).astype(np.int32)
    big, small = np.empty(count + 1, np.int32), np.empty(count + 1, np.int32)
    per = sub * sub
    size = FINE_W * FINE_H * per
    dx, dy, dz = (
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
    )
    best, ids = np.empty(size, np.float32), np.empty(size, np.int32)
    off_x, off_y = np.empty(per, np.float32), np.empty(per, np.float32)
    for s in range(per):
        # A sheared grid: every sample has its own row and column offset, so near-axis edges get ``per`` grey levels.
        col, line = s % sub, s // sub
        off_x[s] = (col + (line + 0.5) / sub) / sub - 0.5
        off_y[s] = (line + (col + 0.5) / sub) / sub - 0.5
    seen_group, seen_prim, seen_n = (
        np.empty(per, np.int32),
        np.empty(per, np.int32),
        np.empty(per, np.int32),
    )
    seen_x, seen_y = np.empty(per, np.float32), np.empty(per, np.float32)
    stack = np.empty(128, np.int32)
    for cy in range(coarse.shape[0]):
        for cx in range(coarse.shape[1]):
            n_big = candidates(f, index, shape, every, count, coarse[cy, cx], big)
            for ty in range(
                cy * (COARSE_H // FINE_H),
                min((cy + 1) * (COARSE_H // FINE_H), fine.shape[0]),
            ):
                for tx in range(
                    cx * (COARSE_W // FINE_W),
                    min((cx + 1) * (COARSE_W // FINE_W), fine.shape[1]),
                ):
                    n_small = candidates(f, index, shape, big, n_big, fine[ty, tx], small)
                    if n_small == 0:
                        continue
                    y0, x0 = ty * FINE_H, tx * FINE_W
                    y1, x1 = min(y0 + FINE_H, H), min(x0 + FINE_W, W)
                    n = 0
                    for y in range(y0, y1):
                        for x in range(x0, x1):
                            for s in range(per):
                                dx[n] = rays[y, x, 0] + off_x[s] * ray_x[y, x, 0] + off_y[s] * ray_y[y, x, 0]
                                dy[n] = rays[y, x, 1] + off_x[s] * ray_x[y, x, 1] + off_y[s] * ray_y[y, x, 1]
                                dz[n] = rays[y, x, 2] + off_x[s] * ray_x[y, x, 2] + off_y[s] * ray_y[y, x, 2]
                                n += 1
                    nearest(f, index, shape, small, n_small, dx, dy, dz, n, best, ids)
                    n = 0
                    for y in range(y0, y1):
                        for x in range(x0, x1):
                            seen = 0
                            for s in range(per):
                                row = ids[n + s]
                                if row < 0:
                                    continue
                                mine = group[index[row]]
                                k = 0
                                while k < seen and seen_group[k] != mine:
                                    k += 1
                                if k == seen:
                                    seen_group[k], seen_prim[k], seen_n[k] = mine, row, 0
                                    seen_x[k], seen_y[k] = 0.0, 0.0
                                    seen += 1
                                seen_n[k] += 1
                                seen_x[k] += off_x[s]
                                seen_y[k] += off_y[s]
                            n += per
                            for k in range(seen):
                                ox, oy = seen_x[k] / seen_n[k], seen_y[k] / seen_n[k]
                                d0 = rays[y, x, 0] + ox * ray_x[y, x, 0] + oy * ray_y[y, x, 0]
                                d1 = rays[y, x, 1] + ox * ray_x[y, x, 1] + oy * ray_y[y, x, 1]
                                d2 = rays[y, x, 2] + ox * ray_x[y, x, 2] + oy * ray_y[y, x, 2]
                                row = seen_prim[k]
                                i = index[row]
                                share = seen_n[k] / per
                                w = f[row, 0] * d0 + f[row, 1] * d1 + f[row, 2] * d2
                                if w < 1e-6:
                                    continue
                                t = 1.0 / w
                                u = (f[row, 3] * d0 + f[row, 4] * d1 + f[row, 5] * d2) * t
                                v = (f[row, 6] * d0 + f[row, 7] * d1 + f[row, 8] * d2) * t
                                # d(U/W) = (dU - u dW)/W along each pixel axis, narrowed to the part that is seen.
                                foot = np.sqrt(share) * t
                                gx, gy, gz = (
                                    ray_x[y, x, 0],
                                    ray_x[y, x, 1],
                                    ray_x[y, x, 2],
                                )
                                dw = f[row, 0] * gx + f[row, 1] * gy + f[row, 2] * gz
                                ux = (f[row, 3] * gx + f[row, 4] * gy + f[row, 5] * gz - u * dw) * foot
                                vx = (f[row, 6] * gx + f[row, 7] * gy + f[row, 8] * gz - v * dw) * foot
                                gx, gy, gz = (
                                    ray_y[y, x, 0],
                                    ray_y[y, x, 1],
                                    ray_y[y, x, 2],
                                )
                                dw = f[row, 0] * gx + f[row, 1] * gy + f[row, 2] * gz
                                uy = (f[row, 3] * gx + f[row, 4] * gy + f[row, 5] * gz - u * dw) * foot
                                vy = (f[row, 6] * gx + f[row, 7] * gy + f[row, 8] * gz - v * dw) * foot
                                r, g, b = _surface(
                                    i,
                                    u,
                                    v,
                                    ux,
                                    vx,
                                    uy,
                                    vy,
                                    look,
                                    uv,
                                    tint,
                                    macro,
                                    glow,
                                    texels,
                                    table,
                                    light,
                                    MAX_TAPS,
                                )
                                if coat[i] > 0:
                                    length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                                    e0 = (R_wc[0, 0] * d0 + R_wc[0, 1] * d1 + R_wc[0, 2] * d2) / length
                                    e1 = (R_wc[1, 0] * d0 + R_wc[1, 1] * d1 + R_wc[1, 2] * d2) / length
                                    e2 = (R_wc[2, 0] * d0 + R_wc[2, 1] * d1 + R_wc[2, 2] * d2) / length
                                    dist = t * length
                                    c = e0 * normal[i, 0] + e1 * normal[i, 1] + e2 * normal[i, 2]
                                    m0, m1, m2 = (
                                        e0 - 2 * c * normal[i, 0],
                                        e1 - 2 * c * normal[i, 1],
                                        e2 - 2 * c * normal[i, 2],
                                    )
                                    side = -1.0 if c > 0 else 1.0
                                    fresnel = coat[i] + (1 - coat[i]) * (1 - abs(c)) ** 5
                                    q0 = centre[0] + dist * e0 + 1e-3 * side * normal[i, 0]
                                    q1 = centre[1] + dist * e1 + 1e-3 * side * normal[i, 1]
                                    q2 = centre[2] + dist * e2 + 1e-3 * side * normal[i, 2]
                                    hit, far, hu, hv = trace(
                                        boxes,
                                        links,
                                        planes,
                                        tree_shape,
                                        q0,
                                        q1,
                                        q2,
                                        m0,
                                        m1,
                                        m2,
                                        1e3,
                                        False,
                                        stack,
                                    )
                                    mr, mg, mb = 0.0, 0.0, 0.0
                                    if hit >= 0:
                                        j = order[hit]
                                        spread = 0.5 * (
                                            np.sqrt(ray_x[y, x, 0] ** 2 + ray_x[y, x, 1] ** 2 + ray_x[y, x, 2] ** 2)
                                            + np.sqrt(ray_y[y, x, 0] ** 2 + ray_y[y, x, 1] ** 2 + ray_y[y, x, 2] ** 2)
                                        )
                                        wide = 1.5 * spread * (dist + far)
                                        ku = wide * np.sqrt(dual_u[j, 0] ** 2 + dual_u[j, 1] ** 2 + dual_u[j, 2] ** 2)
                                        kv = wide * np.sqrt(dual_v[j, 0] ** 2 + dual_v[j, 1] ** 2 + dual_v[j, 2] ** 2)
                                        mr, mg, mb = _surface(
                                            j,
                                            hu,
                                            hv,
                                            ku,
                                            0.0,
                                            0.0,
                                            kv,
                                            look,
                                            uv,
                                            tint,
                                            macro,
                                            glow,
                                            texels,
                                            table,
                                            light,
                                            1,
                                        )
                                    r += fresnel * (min(mr, 6.0) - r)
                                    g += fresnel * (min(mg, 6.0) - g)
                                    b += fresnel * (min(mb, 6.0) - b)
                                out[y, x, 0] += share * tone(r, gain)
                                out[y, x, 1] += share * tone(g, gain)
                                out[y, x, 2] += share * tone(b, gain)


@njit(nogil=True, cache=True)
def encode(image: Any, scale: float, sigma: float, rng: Any, out: Any) -> None:
    """Display-linear (H, W, 3) x scale -> sRGB curve, Gaussian noise of ``sigma`` (0..1 units) -> uint8."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            for m in range(3):
                c = min(max(image[y, x, m] * scale, 0.0), 1.0)
                c = 12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055
                if sigma > 0:
                    c += sigma * rng.standard_normal()
                out[y, x, m] = np.uint8(min(max(c, 0.0), 1.0) * 255.0 + 0.5)

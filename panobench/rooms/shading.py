"""Radiance of a hit, and whole frames: anisotropic texture filtering, baked light, one mirror ray, anti-aliasing.

Visibility is sampled ``sub`` x ``sub`` times per pixel. Every surface seen in a pixel is shaded once, with its texture
averaged over the pixel's footprint (mip maps, up to eight taps along the longer axis), and weighted by the share of
samples that see it. The average is taken after the tone curve, so that bright lamps have smooth edges.

The kernels share these arrays: ``look``, ``paint`` and ``light`` of ``scene.Surfaces``; ``texels`` and ``table`` of
``textures.TextureAtlas``; ``view`` (4, 3), the rows of the camera-to-world rotation, then the centre.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from panobench.kernels.jit import njit
from panobench.rooms.trace import trace
from panobench.rooms.visibility import COARSE_H, COARSE_W, FINE_H, FINE_W, candidates, edge_functions, nearest

MAX_TAPS = 8.0
FAST = {"contract", "nsz", "reassoc", "arcp"}
WHITE_LIMIT = 6.0  # the most radiance that a mirror passes on, in display whites

# Columns of ``look``.
TEXTURE, MACRO, LIGHT_KIND, NODE0, NODE1, NODE2, GROUP = range(7)
# First columns of ``paint``: texture coordinates, tint, macro strength, emission, coat.
UV, TINT, MACRO_STRENGTH, GLOW, COAT = 0, 6, 9, 10, 13


@njit(nogil=True, cache=True, error_model="numpy")
def node_light(look: Any, light: Any, i: int, u: float, v: float) -> tuple[float, float, float]:
    """Irradiance / pi of primitive i at (u, v), linear RGB, interpolated between its nodes."""
    if look[i, LIGHT_KIND] == 1:
        a, b, c, d = look[i, NODE0], look[i, NODE1], look[i, NODE2], 0
        wa, wb, wc, wd = 1.0 - u - v, u, v, 0.0
    else:
        nu, nv = look[i, NODE1], look[i, NODE2]
        x, y = min(max(u, 0.0), 1.0) * (nu - 1), min(max(v, 0.0), 1.0) * (nv - 1)
        x0, y0 = min(int(x), nu - 2), min(int(y), nv - 2)
        fx, fy = x - x0, y - y0
        a = look[i, NODE0] + y0 * nu + x0
        b, c, d = a + 1, a + nu, a + nu + 1
        wa, wb, wc, wd = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        wa * light[a, 0] + wb * light[b, 0] + wc * light[c, 0] + wd * light[d, 0],
        wa * light[a, 1] + wb * light[b, 1] + wc * light[c, 1] + wd * light[d, 1],
        wa * light[a, 2] + wb * light[b, 2] + wc * light[c, 2] + wd * light[d, 2],
    )


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _texel(texels: Any, first: int, lw: int, lh: int, x: float, y: float) -> tuple[float, float, float]:
    """Linear RGB by a bilinear look-up in one mip level; x, y in texels, wrapping. Texels are 255 sqrt(linear)."""
    xf, yf = np.floor(x - 0.5), np.floor(y - 0.5)
    fx, fy = x - 0.5 - xf, y - 0.5 - yf
    mx, my = (1 << lw) - 1, (1 << lh) - 1
    x0, y0 = int(xf) & mx, int(yf) & my
    x1, y1 = (x0 + 1) & mx, (y0 + 1) & my
    r, g, b = 0.0, 0.0, 0.0
    for k in range(4):
        at = first + ((y1 if k >= 2 else y0) << lw) + (x1 if k & 1 else x0)
        w = (fx if k & 1 else 1.0 - fx) * (fy if k >= 2 else 1.0 - fy)
        c0, c1, c2 = float(texels[at, 0]), float(texels[at, 1]), float(texels[at, 2])
        r, g, b = r + w * c0 * c0, g + w * c1 * c1, b + w * c2 * c2
    k0 = 1.0 / 65025.0
    return r * k0, g * k0, b * k0


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _filtered(
    texels: Any, table: Any, t: int, s: float, r: float, sx: float, rx: float, sy: float, ry: float, taps: float
) -> tuple[float, float, float]:
    """Texture t at (s, r) averaged over the parallelogram of (sx, rx) and (sy, ry); all in repeats."""
    first, lw, lh = table[t, 0], table[t, 1], table[t, 2]
    W, H = float(1 << lw), float(1 << lh)
    ax, ay, bx, by = sx * W, rx * H, sy * W, ry * H
    # The axes of the footprint ellipse are the singular values of [[ax, bx], [ay, by]].
    p, q, c = ax * ax + bx * bx, ay * ay + by * by, ax * ay + bx * by
    mid, dif = 0.5 * (p + q), 0.5 * (p - q)
    root = np.sqrt(dif * dif + c * c)
    major, minor = np.sqrt(max(mid + root, 1e-12)), np.sqrt(max(mid - root, 0.0))
    n = int(min(taps, max(1.0, np.ceil(major / max(minor, 1.0) - 0.05))))
    ux, uy = (dif + root, c) if dif >= 0 else (c, root - dif)
    length = np.sqrt(ux * ux + uy * uy) + 1e-12
    ux, uy = ux / length, uy / length
    lod = min(np.log2(max(max(minor, major / n), 1.0)), float(max(lw, lh)) - 1e-3)
    level = int(max(lod, 0.0))
    f = max(lod, 0.0) - level
    # Find where the level starts: each level halves both sides, down to 1.
    w0, h0, at = lw, lh, first
    for _ in range(level):
        at += 1 << (w0 + h0)
        w0, h0 = max(w0 - 1, 0), max(h0 - 1, 0)
    r0, g0, b0 = 0.0, 0.0, 0.0
    for step in range(2):
        share = f if step == 1 else 1.0 - f
        if share > 0.02:
            ix, iy = 1.0 / (1 << (lw - w0)), 1.0 / (1 << (lh - h0))
            for k in range(n):
                o = ((k + 0.5) / n - 0.5) * major
                a, b, d = _texel(texels, at, w0, h0, (s * W + o * ux) * ix, (r * H + o * uy) * iy)
                r0, g0, b0 = r0 + share * a, g0 + share * b, b0 + share * d
        at += 1 << (w0 + h0)
        w0, h0 = max(w0 - 1, 0), max(h0 - 1, 0)
    total = n * ((f if f > 0.02 else 0.0) + (1.0 - f if 1.0 - f > 0.02 else 0.0))
    return r0 / total, g0 / total, b0 / total


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def surface(
    i: int, u: float, v: float, ux: float, vx: float, uy: float, vy: float,
    look: Any, paint: Any, texels: Any, table: Any, light: Any, taps: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Diffuse or emitted radiance of primitive i at (u, v), over the footprint (ux, vx), (uy, vy) of a pixel."""
    s = paint[i, 0] + u * paint[i, 1] + v * paint[i, 2]
    t = paint[i, 3] + u * paint[i, 4] + v * paint[i, 5]
    sx, tx = ux * paint[i, 1] + vx * paint[i, 2], ux * paint[i, 4] + vx * paint[i, 5]
    sy, ty = uy * paint[i, 1] + vy * paint[i, 2], uy * paint[i, 4] + vy * paint[i, 5]
    r, g, b = 1.0, 1.0, 1.0
    if look[i, TEXTURE] > 0:
        r, g, b = _filtered(texels, table, look[i, TEXTURE], s, t, sx, tx, sy, ty, taps)
    if paint[i, GLOW] > 0.0:
        return r * paint[i, GLOW], g * paint[i, GLOW + 1], b * paint[i, GLOW + 2]
    if look[i, MACRO] >= 0:
        # Rotated and at an odd ratio, so that no two repeats of the base texture look alike.
        m, _, _ = _filtered(
            texels, table, look[i, MACRO], 0.296 * s + 0.222 * t, 0.296 * t - 0.222 * s,
            0.37 * sx, 0.37 * tx, 0.37 * sy, 0.37 * ty, 1.0,
        )  # fmt: skip
        f = 1.0 + paint[i, MACRO_STRENGTH] * (2.0 * m - 1.0)
        r, g, b = r * f, g * f, b * f
    lr, lg, lb = node_light(look, light, i, u, v)
    return r * lr * paint[i, TINT], g * lg * paint[i, TINT + 1], b * lb * paint[i, TINT + 2]


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def tone(x: float, gain: float) -> float:
    """Display-linear value in 0..1: linear up to 0.6, then an exponential shoulder that starts with the same slope."""
    x = x * gain
    return x if x < 0.6 else 0.6 + 0.4 * (1.0 - np.exp((0.6 - x) * 2.5))


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def mirrored(
    i: int, d0: float, d1: float, d2: float, t: float, spread: float, view: Any, normal: Any, duals: Any,
    look: Any, paint: Any, texels: Any, table: Any, light: Any,
    boxes: Any, links: Any, planes: Any, tree_shape: Any, order: Any, stack: Any,
) -> tuple[float, float, float, float]:  # fmt: skip
    """(r, g, b) that primitive i reflects, and its Fresnel weight (Schlick 1994).

    d0, d1, d2: ray in the camera frame; t: distance in units of its length; spread: half size of a pixel, radians.
    """
    length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    e0 = (view[0, 0] * d0 + view[0, 1] * d1 + view[0, 2] * d2) / length
    e1 = (view[1, 0] * d0 + view[1, 1] * d1 + view[1, 2] * d2) / length
    e2 = (view[2, 0] * d0 + view[2, 1] * d1 + view[2, 2] * d2) / length
    n0, n1, n2 = normal[i, 0], normal[i, 1], normal[i, 2]
    dist = t * length
    c = e0 * n0 + e1 * n1 + e2 * n2
    fresnel = paint[i, COAT] + (1.0 - paint[i, COAT]) * (1.0 - min(abs(c), 1.0)) ** 5
    off = -1e-3 if c > 0.0 else 1e-3
    hit, far, u, v = trace(
        boxes, links, planes, tree_shape,
        view[3, 0] + dist * e0 + off * n0, view[3, 1] + dist * e1 + off * n1, view[3, 2] + dist * e2 + off * n2,
        e0 - 2.0 * c * n0, e1 - 2.0 * c * n1, e2 - 2.0 * c * n2, 1e3, 0.0, stack,
    )  # fmt: skip
    if hit < 0:
        return 0.0, 0.0, 0.0, fresnel
    j = order[hit]
    # The coat is slightly rough: the footprint of the reflection is twice that of a pixel.
    wide = 2.0 * spread * (dist + far)
    ku = wide * np.sqrt(duals[j, 0] ** 2 + duals[j, 1] ** 2 + duals[j, 2] ** 2)
    kv = wide * np.sqrt(duals[j, 3] ** 2 + duals[j, 4] ** 2 + duals[j, 5] ** 2)
    r, g, b = surface(j, u, v, ku, 0.0, 0.0, kv, look, paint, texels, table, light, 1.0)
    return min(r, WHITE_LIMIT), min(g, WHITE_LIMIT), min(b, WHITE_LIMIT), fresnel


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _shade_tile(
    x0: int, x1: int, y0: int, y1: int, ids: Any, offsets: Any, f: Any, index: Any, rays: Any, ray_x: Any, ray_y: Any,
    gain: float, view: Any, normal: Any, duals: Any,
    look: Any, paint: Any, texels: Any, table: Any, light: Any,
    boxes: Any, links: Any, planes: Any, tree_shape: Any, order: Any, stack: Any, seen_id: Any, seen: Any, out: Any,
) -> None:  # fmt: skip
    """Shade the surfaces that the visibility samples of one tile hit."""
    per = offsets.shape[0]
    n = 0
    for y in range(y0, y1):
        for x in range(x0, x1):
            kinds = 0
            for s in range(per):
                row = ids[n + s]
                if row < 0:
                    continue
                mine = look[index[row], GROUP]
                k = 0
                while k < kinds and seen_id[k, 0] != mine:
                    k += 1
                if k == kinds:
                    seen_id[k, 0], seen_id[k, 1] = mine, row
                    seen[k, 0], seen[k, 1], seen[k, 2] = 0.0, 0.0, 0.0
                    kinds += 1
                seen[k, 0] += 1.0
                seen[k, 1] += offsets[s, 0]
                seen[k, 2] += offsets[s, 1]
            n += per
            ax, ay, az = ray_x[y, x, 0], ray_x[y, x, 1], ray_x[y, x, 2]
            bx, by, bz = ray_y[y, x, 0], ray_y[y, x, 1], ray_y[y, x, 2]
            for k in range(kinds):
                ox, oy = seen[k, 1] / seen[k, 0], seen[k, 2] / seen[k, 0]
                d0 = rays[y, x, 0] + ox * ax + oy * bx
                d1 = rays[y, x, 1] + ox * ay + oy * by
                d2 = rays[y, x, 2] + ox * az + oy * bz
                row = seen_id[k, 1]
                i = index[row]
                share = seen[k, 0] / per
                w = f[row, 0] * d0 + f[row, 1] * d1 + f[row, 2] * d2
                if w < 1e-6:
                    continue
                t = 1.0 / w
                u = (f[row, 3] * d0 + f[row, 4] * d1 + f[row, 5] * d2) * t
                v = (f[row, 6] * d0 + f[row, 7] * d1 + f[row, 8] * d2) * t
                # d(U/W) = (dU - u dW)/W along each pixel axis, scaled down to the share that is seen.
                foot = np.sqrt(share) * t
                dw = f[row, 0] * ax + f[row, 1] * ay + f[row, 2] * az
                ux = (f[row, 3] * ax + f[row, 4] * ay + f[row, 5] * az - u * dw) * foot
                vx = (f[row, 6] * ax + f[row, 7] * ay + f[row, 8] * az - v * dw) * foot
                dw = f[row, 0] * bx + f[row, 1] * by + f[row, 2] * bz
                uy = (f[row, 3] * bx + f[row, 4] * by + f[row, 5] * bz - u * dw) * foot
                vy = (f[row, 6] * bx + f[row, 7] * by + f[row, 8] * bz - v * dw) * foot
                r, g, b = surface(i, u, v, ux, vx, uy, vy, look, paint, texels, table, light, MAX_TAPS)
                if paint[i, COAT] > 0.0:
                    spread = 0.5 * (np.sqrt(ax * ax + ay * ay + az * az) + np.sqrt(bx * bx + by * by + bz * bz))
                    mr, mg, mb, fresnel = mirrored(
                        i, d0, d1, d2, t, spread, view, normal, duals, look, paint, texels, table, light,
                        boxes, links, planes, tree_shape, order, stack,
                    )  # fmt: skip
                    r += fresnel * (mr - r)
                    g += fresnel * (mg - g)
                    b += fresnel * (mb - b)
                out[y, x, 0] += share * tone(r, gain)
                out[y, x, 1] += share * tone(g, gain)
                out[y, x, 2] += share * tone(b, gain)


@njit(nogil=True, cache=True, error_model="numpy")
def render_frame(
    view: Any, rays: Any, ray_x: Any, ray_y: Any, coarse: Any, fine: Any, offsets: Any, gain: float,
    only: Any, p0: Any, duals: Any, normal: Any, two_sided: Any, shape: Any,
    look: Any, paint: Any, texels: Any, table: Any, light: Any,
    boxes: Any, links: Any, planes: Any, tree_shape: Any, order: Any, out: Any,
) -> None:  # fmt: skip
    """Add one frame's display-linear RGB to ``out`` (H, W, 3) float32.

    rays, ray_x, ray_y, coarse, fine: of ``render.RayBundle``. offsets: (S, 2) visibility samples in a pixel.
    only: numbers of the primitives that may be seen.
    """
    H, W = rays.shape[0], rays.shape[1]
    f = np.empty((only.shape[0], 9), np.float32)
    index = np.empty(only.shape[0], np.int32)
    count = edge_functions(only, p0, duals, normal, two_sided, view, f, index)
    every = np.arange(count).astype(np.int32)
    big, small = np.empty(count + 1, np.int32), np.empty(count + 1, np.int32)
    per = offsets.shape[0]
    dirs = np.empty((3, FINE_W * FINE_H * per), np.float32)
    best, ids = np.empty(FINE_W * FINE_H * per, np.float32), np.empty(FINE_W * FINE_H * per, np.int32)
    seen_id, seen = np.empty((per, 2), np.int32), np.empty((per, 3), np.float32)
    stack = np.empty(128, np.int32)
    down, across = COARSE_H // FINE_H, COARSE_W // FINE_W
    for tile in range(coarse.shape[0] * coarse.shape[1]):
        cy, cx = tile // coarse.shape[1], tile % coarse.shape[1]
        n_big = candidates(f, index, shape, every, count, coarse[cy, cx], big)
        for part in range(down * across):
            ty, tx = cy * down + part // across, cx * across + part % across
            if ty >= fine.shape[0] or tx >= fine.shape[1]:
                continue
            n_small = candidates(f, index, shape, big, n_big, fine[ty, tx], small)
            if n_small == 0:
                continue
            y0, x0 = ty * FINE_H, tx * FINE_W
            y1, x1 = min(y0 + FINE_H, H), min(x0 + FINE_W, W)
            n = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    for s in range(per):
                        for a in range(3):
                            dirs[a, n] = rays[y, x, a] + offsets[s, 0] * ray_x[y, x, a] + offsets[s, 1] * ray_y[y, x, a]
                        n += 1
            nearest(f, index, shape, small, n_small, dirs[0], dirs[1], dirs[2], n, best, ids)
            _shade_tile(
                x0, x1, y0, y1, ids, offsets, f, index, rays, ray_x, ray_y, gain, view, normal, duals,
                look, paint, texels, table, light, boxes, links, planes, tree_shape, order, stack, seen_id, seen, out,
            )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
def encode(image: Any, sigma: float, rng: Any, out: Any) -> None:
    """Write uint8 (H, W, 3) of a display-linear image: sRGB curve, then Gaussian noise of ``sigma`` (full scale 1)."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            for m in range(3):
                c = min(max(image[y, x, m], 0.0), 1.0)
                c = 12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055
                if sigma > 0:
                    c += sigma * rng.standard_normal()
                out[y, x, m] = np.uint8(min(max(c, 0.0), 1.0) * 255.0 + 0.5)

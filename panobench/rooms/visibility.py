"""The primitive that each ray from the camera centre sees, exactly, by homogeneous edge functions over tiles.

For a fixed centre c a primitive (corner p0, unit normal n, dual edges a, b) becomes three vectors: with
k = n.(p0 - c), W = n/k, U = a - (a.(p0 - c)) W, V = b - (b.(p0 - c)) W, a ray d meets its plane at distance 1/(W.d),
at coordinates (U.d/W.d, V.d/W.d). So a test needs no division, and the nearest hit has the largest W.d (Olano & Greer,
"Triangle scan conversion using 2D homogeneous coordinates", 1997, here for directions). Each tile has a list of the
primitives that may touch its bounding cone: the maximum of f.d over a cone is |f| cos(max(0, angle - half angle)).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from panobench.kernels.jit import njit
from panobench.rooms.mesh import DISC, RECT, TRIANGLE

COARSE_W, COARSE_H = 64, 32  # pixels of a coarse tile; multiples of the fine one's
FINE_W, FINE_H = 16, 8
TOLERANCE = 2e-5  # in units of an edge: closes the cracks that float32 leaves between neighbours


@njit(nogil=True, cache=True, error_model="numpy")
def edge_functions(only: Any, p0: Any, duals: Any, normal: Any, two_sided: Any, view: Any, out: Any, index: Any) -> int:
    """Fill ``out`` (N, 9) float32 with W, U, V in the camera frame of the primitives ``only`` that face the centre.

    duals: (N, 6) dual edges. view: (4, 3) rows of the camera-to-world rotation, then the centre. ``index`` gets the
    primitives' numbers. Returns how many there are.
    """
    count = 0
    for i in only:
        q0, q1, q2 = p0[i, 0] - view[3, 0], p0[i, 1] - view[3, 1], p0[i, 2] - view[3, 2]
        n0, n1, n2 = normal[i, 0], normal[i, 1], normal[i, 2]
        k = n0 * q0 + n1 * q1 + n2 * q2
        if abs(k) < 1e-9 or (k > 0 and not two_sided[i]):
            continue
        a0, a1, a2, b0, b1, b2 = duals[i, 0], duals[i, 1], duals[i, 2], duals[i, 3], duals[i, 4], duals[i, 5]
        ku, kv = a0 * q0 + a1 * q1 + a2 * q2, b0 * q0 + b1 * q1 + b2 * q2
        w0, w1, w2 = n0 / k, n1 / k, n2 / k
        u0, u1, u2 = a0 - ku * w0, a1 - ku * w1, a2 - ku * w2
        v0, v1, v2 = b0 - kv * w0, b1 - kv * w1, b2 - kv * w2
        for j in range(3):
            r0, r1, r2 = view[0, j], view[1, j], view[2, j]
            out[count, j] = r0 * w0 + r1 * w1 + r2 * w2
            out[count, 3 + j] = r0 * u0 + r1 * u1 + r2 * u2
            out[count, 6 + j] = r0 * v0 + r1 * v1 + r2 * v2
        index[count] = i
        count += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _reaches(
    x: float,
    y: float,
    z: float,
    ax: float,
    ay: float,
    az: float,
    cos_h: float,
    sin_h: float,
) -> bool:
    """Whether the linear function (x, y, z).d is positive for some direction d in the cone."""
    along = x * ax + y * ay + z * az
    norm2 = x * x + y * y + z * z
    across = np.sqrt(max(norm2 - along * along, 0.0))
    return along * cos_h + across * sin_h > -1e-4 * np.sqrt(norm2)


@njit(nogil=True, cache=True, error_model="numpy")
def _may_touch(
    f: Any,
    i: int,
    shape: int,
    ax: float,
    ay: float,
    az: float,
    cos_h: float,
    sin_h: float,
) -> bool:
    w0, w1, w2 = f[i, 0], f[i, 1], f[i, 2]
    u0, u1, u2 = f[i, 3], f[i, 4], f[i, 5]
    v0, v1, v2 = f[i, 6], f[i, 7], f[i, 8]
    if not _reaches(w0, w1, w2, ax, ay, az, cos_h, sin_h):
        return False
    if not _reaches(u0, u1, u2, ax, ay, az, cos_h, sin_h):
        return False
    if not _reaches(v0, v1, v2, ax, ay, az, cos_h, sin_h):
        return False
    if shape == TRIANGLE:
        return _reaches(w0 - u0 - v0, w1 - u1 - v1, w2 - u2 - v2, ax, ay, az, cos_h, sin_h)
    if not _reaches(w0 - u0, w1 - u1, w2 - u2, ax, ay, az, cos_h, sin_h):
        return False
    return _reaches(w0 - v0, w1 - v1, w2 - v2, ax, ay, az, cos_h, sin_h)


@njit(nogil=True, cache=True, error_model="numpy")
def _least(x: float, y: float, z: float, ax: float, ay: float, az: float, cos_h: float, sin_h: float) -> float:
    """A lower bound of the linear function (x, y, z).d over the directions d in the cone."""
    along = x * ax + y * ay + z * az
    norm2 = x * x + y * y + z * z
    across = np.sqrt(max(norm2 - along * along, 0.0))
    return along * cos_h - across * sin_h - 1e-4 * np.sqrt(norm2)


@njit(nogil=True, cache=True, error_model="numpy")
def _most(x: float, y: float, z: float, ax: float, ay: float, az: float, cos_h: float, sin_h: float) -> float:
    """An upper bound of it."""
    along = x * ax + y * ay + z * az
    norm = np.sqrt(x * x + y * y + z * z)
    if along >= norm * cos_h:
        return norm
    return along * cos_h + np.sqrt(max(norm * norm - along * along, 0.0)) * sin_h + 1e-4 * norm


@njit(nogil=True, cache=True, error_model="numpy")
def _covers(f: Any, i: int, shape: int, ax: float, ay: float, az: float, cos_h: float, sin_h: float) -> bool:
    """Whether every ray of the cone meets a parallelogram or triangle."""
    if shape != RECT and shape != TRIANGLE:
        return False
    w0, w1, w2 = f[i, 0], f[i, 1], f[i, 2]
    u0, u1, u2 = f[i, 3], f[i, 4], f[i, 5]
    v0, v1, v2 = f[i, 6], f[i, 7], f[i, 8]
    if _least(u0, u1, u2, ax, ay, az, cos_h, sin_h) < 0 or _least(v0, v1, v2, ax, ay, az, cos_h, sin_h) < 0:
        return False
    if shape == TRIANGLE:
        return _least(w0 - u0 - v0, w1 - u1 - v1, w2 - u2 - v2, ax, ay, az, cos_h, sin_h) >= 0
    if _least(w0 - u0, w1 - u1, w2 - u2, ax, ay, az, cos_h, sin_h) < 0:
        return False
    return _least(w0 - v0, w1 - v1, w2 - v2, ax, ay, az, cos_h, sin_h) >= 0


@njit(nogil=True, cache=True, error_model="numpy")
def cone_of(rays: Any, y0: int, y1: int, x0: int, x1: int, spread: float) -> tuple[float, float, float, float]:
    """Axis and cosine of the half angle of a cone round a block of rays, widened by ``spread`` radians.

    The cosine is -1, the whole sphere, if the rays cancel, and 2, no cone, if there are none.
    """
    ax, ay, az, found = 0.0, 0.0, 0.0, False
    for y in range(y0, y1):
        for x in range(x0, x1):
            r0, r1, r2 = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
            found = found or r0 != 0.0 or r1 != 0.0 or r2 != 0.0
            ax, ay, az = ax + r0, ay + r1, az + r2
    if not found:
        return 0.0, 0.0, 1.0, 2.0
    norm = np.sqrt(ax * ax + ay * ay + az * az)
    if norm < 1e-9:
        return 0.0, 0.0, 1.0, -1.0
    ax, ay, az = ax / norm, ay / norm, az / norm
    lowest = 1.0
    for y in range(y0, y1):
        for x in range(x0, x1):
            r0, r1, r2 = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
            if r0 != 0.0 or r1 != 0.0 or r2 != 0.0:
                lowest = min(lowest, ax * r0 + ay * r1 + az * r2)
    return (
        ax,
        ay,
        az,
        np.cos(min(np.arccos(max(min(lowest, 1.0), -1.0)) + spread, np.pi)),
    )


@njit(nogil=True, cache=True, error_model="numpy")
def tile_cones(rays: Any, spreads: Any, tile_w: int, tile_h: int) -> Any:
    """(rows, columns, 4) axis and cosine of each tile's cone. spreads: (H, W) half size of the pixels, radians."""
    H, W = rays.shape[0], rays.shape[1]
    rows, cols = (H + tile_h - 1) // tile_h, (W + tile_w - 1) // tile_w
    out = np.zeros((rows, cols, 4))
    for ty in range(rows):
        for tx in range(cols):
            y0, x0 = ty * tile_h, tx * tile_w
            y1, x1 = min(y0 + tile_h, H), min(x0 + tile_w, W)
            spread = 0.0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    spread = max(spread, spreads[y, x])
            out[ty, tx, 0], out[ty, tx, 1], out[ty, tx, 2], out[ty, tx, 3] = cone_of(rays, y0, y1, x0, x1, spread)
    return out


@njit(nogil=True, cache=True, error_model="numpy")
def candidates(f: Any, index: Any, shape: Any, source: Any, count: int, cone: Any, out: Any) -> int:
    """Write to ``out`` the rows of ``f``, of those in ``source[:count]``, that the cone may see; returns how many.

    What is behind something that fills the whole cone is left out, too. Rows keep their order.
    """
    cos_h = cone[3]
    if cos_h > 1.5:
        return 0
    if cos_h < 0.1:
        for j in range(count):
            out[j] = source[j]
        return count
    sin_h = np.sqrt(max(0.0, 1.0 - cos_h * cos_h))
    n, wall = 0, 0.0  # inverse distance at which a wall fills the cone
    for j in range(count):
        i = source[j]
        if not _may_touch(f, i, shape[index[i]], cone[0], cone[1], cone[2], cos_h, sin_h):
            continue
        out[n] = i
        n += 1
        near = _least(f[i, 0], f[i, 1], f[i, 2], cone[0], cone[1], cone[2], cos_h, sin_h)
        if near > wall and _covers(f, i, shape[index[i]], cone[0], cone[1], cone[2], cos_h, sin_h):
            wall = near
    if wall == 0.0:
        return n
    kept = 0
    for j in range(n):
        i = out[j]
        if _most(f[i, 0], f[i, 1], f[i, 2], cone[0], cone[1], cone[2], cos_h, sin_h) >= wall:
            out[kept] = i
            kept += 1
    return kept


@njit(nogil=True, cache=True, fastmath={"contract", "nsz", "reassoc", "arcp"}, error_model="numpy")
def nearest(
    f: Any,
    index: Any,
    shape: Any,
    found: Any,
    count: int,
    dx: Any,
    dy: Any,
    dz: Any,
    n: int,
    best: Any,
    who: Any,
) -> None:
    """For n rays: ``best`` gets the inverse distance of the nearest hit or 0, ``who`` its row in ``f`` or -1."""
    for j in range(n):
        best[j] = np.float32(0.0)
        who[j] = np.int32(-1)
    tol = np.float32(TOLERANCE)
    for c in range(count):
        i = np.int32(found[c])
        w0, w1, w2 = f[i, 0], f[i, 1], f[i, 2]
        u0, u1, u2 = f[i, 3], f[i, 4], f[i, 5]
        v0, v1, v2 = f[i, 6], f[i, 7], f[i, 8]
        kind = shape[index[i]]
        if kind == RECT:
            for j in range(n):
                w = w0 * dx[j] + w1 * dy[j] + w2 * dz[j]
                u = u0 * dx[j] + u1 * dy[j] + u2 * dz[j]
                v = v0 * dx[j] + v1 * dy[j] + v2 * dz[j]
                e = tol * w
                hit = (w > best[j]) & (u >= -e) & (v >= -e) & (w - u >= -e) & (w - v >= -e)
                best[j] = w if hit else best[j]
                who[j] = i if hit else who[j]
        elif kind == TRIANGLE:
            for j in range(n):
                w = w0 * dx[j] + w1 * dy[j] + w2 * dz[j]
                u = u0 * dx[j] + u1 * dy[j] + u2 * dz[j]
                v = v0 * dx[j] + v1 * dy[j] + v2 * dz[j]
                e = tol * w
                hit = (w > best[j]) & (u >= -e) & (v >= -e) & (w - u - v >= -e)
                best[j] = w if hit else best[j]
                who[j] = i if hit else who[j]
        elif kind == DISC:
            for j in range(n):
                w = w0 * dx[j] + w1 * dy[j] + w2 * dz[j]
                u = u0 * dx[j] + u1 * dy[j] + u2 * dz[j] - np.float32(0.5) * w
                v = v0 * dx[j] + v1 * dy[j] + v2 * dz[j] - np.float32(0.5) * w
                hit = (w > best[j]) & (u * u + v * v <= np.float32(0.25) * w * w)
                best[j] = w if hit else best[j]
                who[j] = i if hit else who[j]
        else:
            # A leaf is |v - 1/2| <= 2 u (1 - u); both sides are multiplied by w^2.
            for j in range(n):
                w = w0 * dx[j] + w1 * dy[j] + w2 * dz[j]
                u = u0 * dx[j] + u1 * dy[j] + u2 * dz[j]
                v = v0 * dx[j] + v1 * dy[j] + v2 * dz[j] - np.float32(0.5) * w
                hit = (w > best[j]) & (abs(v) * w <= np.float32(2.0) * u * (w - u))
                best[j] = w if hit else best[j]
                who[j] = i if hit else who[j]


@njit(nogil=True, cache=True, error_model="numpy")
def cast_centres(f: Any, count: int, index: Any, shape: Any, rays: Any, coarse: Any, fine: Any, who: Any) -> None:
    """Write to ``who`` (H, W) the number of the primitive that each pixel's centre ray sees; -1: none."""
    H, W = rays.shape[0], rays.shape[1]
    every = np.arange(count).astype(np.int32)
    big, small = np.empty(count + 1, np.int32), np.empty(count + 1, np.int32)
    dirs = np.empty((3, FINE_W * FINE_H), np.float32)
    best, ids = np.empty(FINE_W * FINE_H, np.float32), np.empty(FINE_W * FINE_H, np.int32)
    down, across = COARSE_H // FINE_H, COARSE_W // FINE_W
    for tile in range(coarse.shape[0] * coarse.shape[1]):
        cy, cx = tile // coarse.shape[1], tile % coarse.shape[1]
        n_big = candidates(f, index, shape, every, count, coarse[cy, cx], big)
        for part in range(down * across):
            ty, tx = cy * down + part // across, cx * across + part % across
            if ty >= fine.shape[0] or tx >= fine.shape[1]:
                continue
            n_small = candidates(f, index, shape, big, n_big, fine[ty, tx], small)
            y0, x0 = ty * FINE_H, tx * FINE_W
            y1, x1 = min(y0 + FINE_H, H), min(x0 + FINE_W, W)
            n = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    for a in range(3):
                        dirs[a, n] = rays[y, x, a]
                    n += 1
            nearest(f, index, shape, small, n_small, dirs[0], dirs[1], dirs[2], n, best, ids)
            n = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    who[y, x] = index[ids[n]] if ids[n] >= 0 else -1
                    n += 1


@njit(nogil=True, cache=True, error_model="numpy")
def plane_depth(p0: Any, normal: Any, who: Any, rays: Any, view: Any, out: Any) -> None:
    """Write to ``out`` (H, W) the radial depth of the primitives seen, from float64 arithmetic; NaN: none."""
    for y in range(who.shape[0]):
        for x in range(who.shape[1]):
            i = who[y, x]
            if i < 0:
                out[y, x] = np.nan
                continue
            k, s = 0.0, 0.0
            for a in range(3):
                d = view[a, 0] * rays[y, x, 0] + view[a, 1] * rays[y, x, 1] + view[a, 2] * rays[y, x, 2]
                k += normal[i, a] * (p0[i, a] - view[3, a])
                s += normal[i, a] * d
            out[y, x] = k / s

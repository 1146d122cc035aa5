"""Casts rays at solids: what part of each pixel they cover, how far away they are, and their colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.capture.solids import CHECK, CLOTH, HAIR, PAINT, SKIN, STRIPES, Solids
from panobench.kernels.jit import njit

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Visibility samples per pixel side.
SUB = 3
NEAR = 1e-3


@dataclass(frozen=True)
class Light:
    """What falls on a surface: irradiance / pi in the nine spherical harmonics of degree two (9, 3), linear RGB in the
    rays' axes (Ramamoorthi & Hanrahan 2001), and a small panorama (h, w, 3) of the surroundings for reflections.
    """

    harmonics: Array
    panorama: Array32


@dataclass
class Coverage:
    """Share of each pixel that is covered (H, W), premultiplied linear colour (H, W, 3), both float32."""

    share: Array32
    colour: Array32

    def over(self, linear: Array32) -> Array32:
        """This in front of ``linear`` (H, W, 3)."""
        return np.asarray(linear * (1 - self.share[..., None]) + self.colour, dtype=np.float32)


def harmonics(directions: Any) -> Array:
    """The nine real spherical harmonics (..., 9) of unit directions (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    return np.stack(
        [
            np.full_like(x, 0.282095),
            0.488603 * y,
            0.488603 * z,
            0.488603 * x,
            1.092548 * x * y,
            1.092548 * y * z,
            0.315392 * (3 * z * z - 1),
            1.092548 * x * z,
            0.546274 * (x * x - y * y),
        ],
        axis=-1,
    )


#: Share of each band that a diffuse surface keeps, over pi.
_BANDS = np.array([1.0] + 3 * [2 / 3] + 5 * [1 / 4])


def light_of(linear: Array32, rays: Any, solid_angle: Any, panorama: Array32 | None = None) -> Light:
    """The light of a view: linear RGB (H, W, 3) along unit rays (H, W, 3) with their solid angles (H, W).

    A view that does not cover the sphere stands for all of it by its mean.
    """
    weights = np.asarray(solid_angle, dtype=np.float64) * 4 * np.pi / max(float(np.sum(solid_angle)), 1e-9)
    Y = harmonics(np.nan_to_num(rays)) * weights[..., None]
    found = np.einsum("hwk,hwc->kc", Y, linear.astype(np.float64)) * _BANDS[:, None]
    if float(np.sum(solid_angle)) < 12.0:
        found[1:] *= 0.3
    if panorama is None:
        mean = (linear * weights[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
        panorama = mean.astype(np.float32)[None, None]
    return Light(found, np.ascontiguousarray(panorama, dtype=np.float32))


@njit(nogil=True, cache=True, error_model="numpy")
def _hash(i: int, j: int, k: int, seed: int) -> float:
    h = (i * 374761393 + j * 668265263 + k * 2147483647 + seed * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return float((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0


@njit(nogil=True, cache=True, error_model="numpy")
def _noise(x: float, y: float, z: float, seed: int) -> float:
    """Value noise in 0..1, one cell per unit."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
                total += weight * _hash(i + a, j + b, k + c, seed)
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _meet(kind: int, s: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Distance along a unit ray to a solid, 1e30 if it is missed."""
    if kind == 1:
        px, py, pz = ox - s[0], oy - s[1], oz - s[2]
        ax, ay, az = (
            s[3] * px + s[4] * py + s[5] * pz,
            s[6] * px + s[7] * py + s[8] * pz,
            s[9] * px + s[10] * py + s[11] * pz,
        )
        bx, by, bz = (
            s[3] * dx + s[4] * dy + s[5] * dz,
            s[6] * dx + s[7] * dy + s[8] * dz,
            s[9] * dx + s[10] * dy + s[11] * dz,
        )
        return _root(bx * bx + by * by + bz * bz, ax * bx + ay * by + az * bz, ax * ax + ay * ay + az * az - 1.0)
    wx, wy, wz = ox - s[0], oy - s[1], oz - s[2]
    ra, e = s[3], s[7]
    dd = s[4] * s[4] + s[5] * s[5] + s[6] * s[6]
    k = dd - e * e
    wd = wx * s[4] + wy * s[5] + wz * s[6] + ra * e
    vd = dx * s[4] + dy * s[5] + dz * s[6]
    ww = wx * wx + wy * wy + wz * wz
    wv = wx * dx + wy * dy + wz * dz
    best = 1e30
    t = _root(1.0 - vd * vd / k, wv - wd * vd / k, ww - ra * ra - wd * wd / k)
    if t < 1e30:
        at = (wd + t * vd) / k
        if 0.0 <= at <= 1.0:
            best = t
    t = _root(1.0, wv, ww - ra * ra)
    if t < best and wd + t * vd <= 0.0:
        best = t
    qx, qy, qz, rb = wx - s[4], wy - s[5], wz - s[6], ra + e
    t = _root(1.0, qx * dx + qy * dy + qz * dz, qx * qx + qy * qy + qz * qz - rb * rb)
    if t < best and wd + t * vd >= k:
        best = t
    return best


@njit(nogil=True, cache=True, error_model="numpy")
def _root(a: float, b: float, c: float) -> float:
    """The least root beyond ``NEAR`` of a t^2 + 2 b t + c, 1e30 if there is none."""
    disc = b * b - a * c
    if disc < 0.0 or abs(a) < 1e-12:
        return 1e30
    root = np.sqrt(disc)
    first, second = (-b - root) / a, (-b + root) / a
    if first > second:
        first, second = second, first
    if first > NEAR:
        return first
    return second if second > NEAR else 1e30


@njit(nogil=True, cache=True, error_model="numpy")
def _surface(m: Any, lx: float, ly: float, lz: float, seed: int, colour: Any, bump: Any) -> None:
    """Albedo at a local point into ``colour`` and what the folds add to the normal (local axes) into ``bump``."""
    kind, scale, folds = int(m[0]), m[7], m[8]
    mix = 0.0
    gain = 0.85 + 0.3 * _noise(lx * 9, ly * 9, lz * 9, seed)
    if kind == SKIN:
        # Blotches, and creases across the limb.
        mix = 1.2 * _noise(lx * 40, ly * 40, lz * 40, seed + 1) ** 2
        crease = _noise(lx * 60, ly * 60, lz * 260, seed + 2)
        gain *= 0.72 + 0.4 * _noise(lx * 90, ly * 90, lz * 90, seed + 3) + (0.1 if crease < 0.6 else -0.15)
    elif kind == CLOTH:
        weave = np.sin(lx * 900) * np.sin(lz * 900)
        mix = 0.5 * _noise(lx * 14, ly * 14, lz * 14, seed + 3) + 0.15 * weave
    elif kind == STRIPES:
        mix = 1.0 if (lz / scale) % 1.0 < 0.4 else 0.0
    elif kind == CHECK:
        a, b = (lz / scale) % 1.0, (np.arctan2(lx, ly) * 0.12 / scale) % 1.0
        mix = (0.5 if a < 0.5 else 0.0) + (0.5 if b < 0.5 else 0.0)
    elif kind == HAIR:
        angle = np.arctan2(lx, ly + 0.3 * lz)
        strand = _noise(angle * 60 + 3 * _noise(lx * 20, ly * 20, lz * 20, seed + 6), lz * 25, 0.5, seed + 4)
        mix = strand
        gain *= 0.6 + 0.8 * _noise(angle * 14, lz * 10, 2.5, seed + 5)
    mix = min(max(mix, 0.0), 1.0)
    for c in range(3):
        colour[c] = gain * ((1 - mix) * m[1 + c] + mix * m[4 + c])
    for c in range(3):
        bump[c] = 0.0
    if folds > 0.0:
        f, g = 16.0, 38.0
        here = _noise(lx * f, ly * f, lz * f * 0.6, seed + 7) + 0.4 * _noise(lx * g, ly * g, lz * g, seed + 8)
        h = 0.01
        for c in range(3):
            px, py, pz = lx + (h if c == 0 else 0.0), ly + (h if c == 1 else 0.0), lz + (h if c == 2 else 0.0)
            there = _noise(px * f, py * f, pz * f * 0.6, seed + 7) + 0.4 * _noise(px * g, py * g, pz * g, seed + 8)
            bump[c] = -folds * (there - here) / h * 0.05


@njit(nogil=True, cache=True, error_model="numpy")
def _irradiance(sh: Any, x: float, y: float, z: float, out: Any) -> None:
    for c in range(3):
        out[c] = (
            0.282095 * sh[0, c]
            + 0.488603 * (y * sh[1, c] + z * sh[2, c] + x * sh[3, c])
            + 1.092548 * (x * y * sh[4, c] + y * z * sh[5, c] + x * z * sh[7, c])
            + 0.315392 * (3 * z * z - 1) * sh[6, c]
            + 0.546274 * (x * x - y * y) * sh[8, c]
        )
        out[c] = max(out[c], 0.02 * sh[0, c])


@njit(nogil=True, cache=True, error_model="numpy")
def _cast(
    rays: Any, R: Any, origin: Any, offsets: Any, depth: Any, kind: Any, shape: Any, bound: Any, frame: Any,
    centre: Any, material: Any, materials: Any, sh: Any, panorama: Any, seed: int, share: Any, out: Any,
) -> None:  # fmt: skip
    H, W = rays.shape[0], rays.shape[1]
    N = kind.shape[0]
    axis, limit = np.empty((N, 3)), np.empty(N)
    for i in range(N):
        q0, q1, q2 = bound[i, 0] - origin[0], bound[i, 1] - origin[1], bound[i, 2] - origin[2]
        length = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2)
        if length <= bound[i, 3]:
            axis[i, 0], axis[i, 1], axis[i, 2], limit[i] = 0.0, 0.0, 0.0, -1.0
            continue
        axis[i, 0], axis[i, 1], axis[i, 2] = q0 / length, q1 / length, q2 / length
        limit[i] = np.cos(min(np.arcsin(bound[i, 3] / length) + 2.0 * np.pi / W + 0.01, np.pi))
    near = np.empty(N, np.int32)
    colour, bump, lit = np.empty(3), np.empty(3), np.empty(3)
    per = offsets.shape[0]
    for y in range(H):
        for x in range(W):
            r0, r1, r2 = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
            if r0 == 0.0 and r1 == 0.0 and r2 == 0.0:
                continue
            d0 = R[0, 0] * r0 + R[0, 1] * r1 + R[0, 2] * r2
            d1 = R[1, 0] * r0 + R[1, 1] * r1 + R[1, 2] * r2
            d2 = R[2, 0] * r0 + R[2, 1] * r1 + R[2, 2] * r2
            found = 0
            for i in range(N):
                if limit[i] < -0.5 or axis[i, 0] * d0 + axis[i, 1] * d1 + axis[i, 2] * d2 > limit[i]:
                    near[found] = i
                    found += 1
            if found == 0:
                continue
            right, below = (x + 1) if x + 1 < W else x - 1, (y + 1) if y + 1 < H else y - 1
            sx, sy = (1.0 if x + 1 < W else -1.0), (1.0 if y + 1 < H else -1.0)
            for s in range(per):
                u, v = offsets[s, 0] * sx, offsets[s, 1] * sy
                v0 = r0 + u * (rays[y, right, 0] - r0) + v * (rays[below, x, 0] - r0)
                v1 = r1 + u * (rays[y, right, 1] - r1) + v * (rays[below, x, 1] - r1)
                v2 = r2 + u * (rays[y, right, 2] - r2) + v * (rays[below, x, 2] - r2)
                length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
                if length < 0.5:  # a neighbour without a ray
                    v0, v1, v2, length = r0, r1, r2, 1.0
                v0, v1, v2 = v0 / length, v1 / length, v2 / length
                e0 = R[0, 0] * v0 + R[0, 1] * v1 + R[0, 2] * v2
                e1 = R[1, 0] * v0 + R[1, 1] * v1 + R[1, 2] * v2
                e2 = R[2, 0] * v0 + R[2, 1] * v1 + R[2, 2] * v2
                best, who = 1e30, -1
                for j in range(found):
                    i = near[j]
                    t = _meet(kind[i], shape[i], origin[0], origin[1], origin[2], e0, e1, e2)
                    if t < best:
                        best, who = t, i
                if who < 0 or best > depth[y, x]:
                    continue
                px, py, pz = origin[0] + best * e0, origin[1] + best * e1, origin[2] + best * e2
                g = shape[who]
                if kind[who] == 1:
                    ax, ay, az = px - g[0], py - g[1], pz - g[2]
                    b0 = g[3] * ax + g[4] * ay + g[5] * az
                    b1 = g[6] * ax + g[7] * ay + g[8] * az
                    b2 = g[9] * ax + g[10] * ay + g[11] * az
                    n0 = g[3] * b0 + g[6] * b1 + g[9] * b2
                    n1 = g[4] * b0 + g[7] * b1 + g[10] * b2
                    n2 = g[5] * b0 + g[8] * b1 + g[11] * b2
                else:
                    ax, ay, az = px - g[0], py - g[1], pz - g[2]
                    k = g[4] * g[4] + g[5] * g[5] + g[6] * g[6] - g[7] * g[7]
                    at = min(max((ax * g[4] + ay * g[5] + az * g[6] + g[3] * g[7]) / k, 0.0), 1.0)
                    n0, n1, n2 = ax - at * g[4], ay - at * g[5], az - at * g[6]
                f = frame[who]
                qx, qy, qz = px - centre[who, 0], py - centre[who, 1], pz - centre[who, 2]
                _surface(
                    materials[material[who]],
                    f[0, 0] * qx + f[0, 1] * qy + f[0, 2] * qz,
                    f[1, 0] * qx + f[1, 1] * qy + f[1, 2] * qz,
                    f[2, 0] * qx + f[2, 1] * qy + f[2, 2] * qz,
                    seed + material[who] * 31,
                    colour,
                    bump,
                )
                length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                n0 = n0 / length + f[0, 0] * bump[0] + f[1, 0] * bump[1] + f[2, 0] * bump[2]
                n1 = n1 / length + f[0, 1] * bump[0] + f[1, 1] * bump[1] + f[2, 1] * bump[2]
                n2 = n2 / length + f[0, 2] * bump[0] + f[1, 2] * bump[1] + f[2, 2] * bump[2]
                length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                n0, n1, n2 = n0 / length, n1 / length, n2 / length
                # The light is known in the rays' axes.
                m0 = R[0, 0] * n0 + R[1, 0] * n1 + R[2, 0] * n2
                m1 = R[0, 1] * n0 + R[1, 1] * n1 + R[2, 1] * n2
                m2 = R[0, 2] * n0 + R[1, 2] * n1 + R[2, 2] * n2
                _irradiance(sh, m0, m1, m2, lit)
                facing = -(n0 * e0 + n1 * e1 + n2 * e2)
                shade = 0.55 + 0.45 * max(facing, 0.0)  # crevices and rims are darker
                fresnel = 0.0
                if materials[material[who], 0] == PAINT:
                    fresnel = 0.06 + 0.94 * (1.0 - min(abs(facing), 1.0)) ** 5
                    q0, q1, q2 = v0 + 2 * facing * m0, v1 + 2 * facing * m1, v2 + 2 * facing * m2
                    h, w = panorama.shape[0], panorama.shape[1]
                    column = int((np.arctan2(q0, q2) / (2 * np.pi) + 0.5) * w) % w
                    row = min(max(int((0.5 + np.arcsin(min(max(q1, -1.0), 1.0)) / np.pi) * h), 0), h - 1)
                for c in range(3):
                    value = colour[c] * lit[c] * (shade if fresnel == 0.0 else 1.0)
                    if fresnel > 0.0:
                        value = (1 - fresnel) * value + fresnel * panorama[row, column, c]
                    out[y, x, c] += value / per
                share[y, x] += 1.0 / per


def cast(
    solids: Solids,
    rays: Array32,
    T: Array,
    light: Light,
    *,
    depth: Array32 | None = None,
    sub: int = SUB,
    seed: int = 0,
) -> Coverage:
    """What ``solids`` cover of a view along ``rays`` (H, W, 3), zero where there is none.

    ``T`` (4, 4) takes the rays' axes to the solids'. What lies beyond ``depth`` (H, W), radial, is hidden.
    """
    share = np.zeros(rays.shape[:2], dtype=np.float32)
    colour = np.zeros(rays.shape, dtype=np.float32)
    side = (np.arange(sub) + 0.5) / sub - 0.5
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    limit = np.full((1, 1), np.inf, dtype=np.float32) if depth is None else np.nan_to_num(depth, nan=np.inf)
    limit = np.broadcast_to(limit, share.shape)
    s = solids
    _cast(
        np.ascontiguousarray(rays, dtype=np.float32), np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy(), offsets,
        np.ascontiguousarray(limit, dtype=np.float32), s.kind, s.shape, s.bound, s.frame, s.centre, s.material,
        s.materials, light.harmonics, light.panorama, seed, share, colour,
    )  # fmt: skip
    return Coverage(share, colour)

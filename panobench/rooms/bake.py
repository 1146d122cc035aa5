"""Bakes light into the nodes: area lights and sun with soft shadows, then diffuse interreflection.

Direct light comes from shadow rays to stratified points on every light. Indirect light comes from cosine-weighted
rays whose hits are stored, so that further bounces are only look-ups. A node inside an object, most of whose rays meet
back sides, takes its neighbours' light. All light is irradiance / pi.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import njit
from panobench.rooms.mesh import TRIANGLE
from panobench.rooms.scene import Geometry, Surfaces
from panobench.rooms.shading import GLOW, node_light
from panobench.rooms.trace import trace as trace_ray

LIGHT_SAMPLES = 4  # points per light, along each side
BOUNCE_RAYS = 8  # rays per node, along each side of the square that is sampled
BOUNCES = 4


@njit(nogil=True, cache=True, error_model="numpy")
def _hash(a: int, b: int) -> float:
    """Uniform number in 0..1 from two integers (finaliser in the manner of splitmix64)."""
    x = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F)
    x ^= x >> np.uint64(29)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    x ^= x >> np.uint64(32)
    return float(x >> np.uint64(11)) / 9007199254740992.0


@njit(nogil=True, cache=True, error_model="numpy")
def _gather(
    first: int,
    last: int,
    pos: Any,
    normal: Any,
    two: Any,
    boxes: Any,
    links: Any,
    planes: Any,
    shape: Any,
    glowing: Any,
    light_p: Any,
    light_u: Any,
    light_v: Any,
    light_r: Any,
    sun_dir: Any,
    sun_rad: Any,
    grid: int,
    rays: int,
    direct: Any,
    hit: Any,
    hit_u: Any,
    hit_v: Any,
    inside: Any,
) -> None:
    """Direct light of nodes first to last - 1, the hits of their bounce rays, and whether they are inside an object."""
    stack = np.empty(128, np.int32)
    for i in range(first, last):
        n0, n1, n2 = normal[i, 0], normal[i, 1], normal[i, 2]
        # A tangent basis (Duff et al. 2017).
        s = 1.0 if n2 >= 0 else -1.0
        a = -1.0 / (s + n2)
        b = n0 * n1 * a
        t0, t1, t2 = 1.0 + s * n0 * n0 * a, s * b, -s * n0
        c0, c1, c2 = b, s + n1 * n1 * a, -n1
        px, py, pz = pos[i, 0] + 2e-3 * n0, pos[i, 1] + 2e-3 * n1, pos[i, 2] + 2e-3 * n2
        for side in range(2 if two[i] else 1):
            flip = 1.0 - 2.0 * side
            weight = 0.5 if two[i] else 1.0
            ox, oy, oz = (
                px - (4e-3 * n0) * side,
                py - (4e-3 * n1) * side,
                pz - (4e-3 * n2) * side,
            )
            for k in range(light_p.shape[0]):
                l0 = light_u[k, 1] * light_v[k, 2] - light_u[k, 2] * light_v[k, 1]
                l1 = light_u[k, 2] * light_v[k, 0] - light_u[k, 0] * light_v[k, 2]
                l2 = light_u[k, 0] * light_v[k, 1] - light_u[k, 1] * light_v[k, 0]
                # Use more points for a light that may contribute more, by a bound from its centre.
                dx = light_p[k, 0] + 0.5 * (light_u[k, 0] + light_v[k, 0]) - ox
                dy = light_p[k, 1] + 0.5 * (light_u[k, 1] + light_v[k, 1]) - oy
                dz = light_p[k, 2] + 0.5 * (light_u[k, 2] + light_v[k, 2]) - oz
                bound = light_r[k, 1] * np.sqrt(l0 * l0 + l1 * l1 + l2 * l2) / (np.pi * (dx * dx + dy * dy + dz * dz))
                side_n = grid if bound > 0.15 else (grid + 1) // 2 if bound > 0.015 else 1
                total = 0.0
                for j in range(side_n * side_n):
                    fu = (j % side_n + _hash(i, 4096 * k + 2 * j + side)) / side_n
                    fv = (j // side_n + _hash(i + 77, 4096 * k + 2 * j + side)) / side_n
                    dx = light_p[k, 0] + fu * light_u[k, 0] + fv * light_v[k, 0] - ox
                    dy = light_p[k, 1] + fu * light_u[k, 1] + fv * light_v[k, 1] - oy
                    dz = light_p[k, 2] + fu * light_u[k, 2] + fv * light_v[k, 2] - oz
                    r2 = dx * dx + dy * dy + dz * dz
                    r = np.sqrt(r2)
                    cos_here = flip * (dx * n0 + dy * n1 + dz * n2) / r
                    cos_there = -(dx * l0 + dy * l1 + dz * l2) / r  # times the light's area
                    if cos_here <= 0 or cos_there <= 0:
                        continue
                    w, _, _, _ = trace_ray(
                        boxes,
                        links,
                        planes,
                        shape,
                        ox,
                        oy,
                        oz,
                        dx / r,
                        dy / r,
                        dz / r,
                        r - 2e-3,
                        1.0,
                        stack,
                    )
                    if w < 0:
                        total += cos_here * cos_there / max(r2, 0.01)
                total *= weight / (np.pi * side_n * side_n)
                for m in range(3):
                    direct[i, m] += total * light_r[k, m]
            cos_sun = flip * (sun_dir[0] * n0 + sun_dir[1] * n1 + sun_dir[2] * n2)
            if sun_rad[0] > 0 and cos_sun > 0:
                lit = 0.0
                for j in range(9):  # the same directions at every node, for even penumbrae
                    ang, rad = 2.4 * j, 0.022 * np.sqrt((j + 0.5) / 9)
                    s0, s1 = rad * np.cos(ang), rad * np.sin(ang)
                    dx = sun_dir[0] - s0 * sun_dir[1]
                    dy = sun_dir[1] + s0 * sun_dir[0]
                    dz = sun_dir[2] + s1
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    w, _, _, _ = trace_ray(
                        boxes, links, planes, shape, ox, oy, oz, dx / r, dy / r, dz / r, 1e3, 0.0, stack
                    )
                    if w < 0 or glowing[w] == 2:
                        lit += 1.0 / 9
                for m in range(3):
                    direct[i, m] += weight * lit * cos_sun * sun_rad[m]
        back, near_back = 0, 0
        for j in range(rays * rays):
            x1 = (j % rays + _hash(i, 500000 + j)) / rays
            x2 = (j // rays + _hash(i, 600000 + j)) / rays
            rad, ang = np.sqrt(x1), 2 * np.pi * x2
            ca, sa, cz = rad * np.cos(ang), rad * np.sin(ang), np.sqrt(max(0.0, 1 - x1))
            flip = -1.0 if (two[i] and j % 2 == 1) else 1.0
            dx = ca * t0 + sa * c0 + flip * cz * n0
            dy = ca * t1 + sa * c1 + flip * cz * n1
            dz = ca * t2 + sa * c2 + flip * cz * n2
            off = 0.0 if flip > 0 else 4e-3
            w, dist, u, v = trace_ray(
                boxes,
                links,
                planes,
                shape,
                px - off * n0,
                py - off * n1,
                pz - off * n2,
                dx,
                dy,
                dz,
                1e3,
                0.0,
                stack,
            )
            hit[i, j] = w
            hit_u[i, j], hit_v[i, j] = u, v
            if w >= 0 and planes[w, 0] * dx + planes[w, 1] * dy + planes[w, 2] * dz > 0 and glowing[w] != 3:
                hit[i, j] = -1
                back += 1
                near_back += dist < 0.5
        inside[i] = near_back > 0.4 * rays * rays


@njit(nogil=True, cache=True, error_model="numpy")
def _bounce(
    first: int,
    last: int,
    hit: Any,
    hit_u: Any,
    hit_v: Any,
    order: Any,
    look: Any,
    albedo: Any,
    light: Any,
    out: Any,
) -> None:
    """One diffuse bounce: ``out`` gets the mean light that the stored hits reflect."""
    n = hit.shape[1]
    for i in range(first, last):
        s0, s1, s2 = 0.0, 0.0, 0.0
        for j in range(n):
            if hit[i, j] < 0:
                continue
            p = order[hit[i, j]]
            r, g, b = node_light(look, light, p, hit_u[i, j], hit_v[i, j])
            s0, s1, s2 = s0 + albedo[p, 0] * r, s1 + albedo[p, 1] * g, s2 + albedo[p, 2] * b
        out[i, 0], out[i, 1], out[i, 2] = s0 / n, s1 / n, s2 / n


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_inside(base: int, nu: int, nv: int, inside: Any, light: Any, rounds: int) -> None:
    """Give grid nodes inside objects the mean of their lit neighbours, from the outside in."""
    done = np.empty(nu * nv, np.bool_)
    for k in range(nu * nv):
        done[k] = not inside[base + k]
    for _ in range(rounds):
        again = done.copy()
        for y in range(nv):
            for x in range(nu):
                k = y * nu + x
                if done[k]:
                    continue
                s0, s1, s2, n = 0.0, 0.0, 0.0, 0
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        if 0 <= x + dx < nu and 0 <= y + dy < nv and done[k + dy * nu + dx]:
                            q = base + k + dy * nu + dx
                            s0, s1, s2, n = (
                                s0 + light[q, 0],
                                s1 + light[q, 1],
                                s2 + light[q, 2],
                                n + 1,
                            )
                if n > 0:
                    light[base + k, 0], light[base + k, 1], light[base + k, 2] = (
                        s0 / n,
                        s1 / n,
                        s2 / n,
                    )
                    again[k] = True
        done = again


@njit(nogil=True, cache=True, error_model="numpy")
def _smooth(base: int, nu: int, nv: int, light: Any) -> None:
    """One binomial filter pass over a grid, against sampling noise in the indirect light."""
    tmp = light[base : base + nu * nv].copy()
    for m in range(3):
        for y in range(nv):
            for x in range(nu):
                s, w = 0.0, 0.0
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        if 0 <= x + dx < nu and 0 <= y + dy < nv:
                            f = (2 - abs(dx)) * (2 - abs(dy))
                            s += f * tmp[(y + dy) * nu + x + dx, m]
                            w += f
                light[base + y * nu + x, m] = s / w


def bake(geometry: Geometry, surfaces: Surfaces, threads: int) -> NDArray[np.float32]:
    """Light (M, 3) at the nodes, irradiance / pi, linear RGB, before exposure."""
    mesh = geometry.mesh
    m = len(mesh.node_pos)
    n_rays = BOUNCE_RAYS**2
    direct = np.zeros((m, 3))
    hit = np.full((m, n_rays), -1, dtype=np.int32)
    hit_u, hit_v = np.zeros((m, n_rays), np.float32), np.zeros((m, n_rays), np.float32)
    inside = np.zeros(m, dtype=np.bool_)
    lights = mesh.lights
    pack = [np.array([getattr(L, key) for L in lights]).reshape(-1, 3) for key in ("p0", "eu", "ev", "radiance")]
    sun_dir, sun_rad = mesh.sun if mesh.sun is not None else (np.array([0.0, 0.0, 1.0]), np.zeros(3))
    # 1: emits; 2: the view outdoors, through which the sun shines; 3: two-sided, so that back sides are not inside.
    glow = np.any(surfaces.paint[:, GLOW : GLOW + 3] > 0, axis=1)
    outdoors = np.array([mat.texture.startswith("outdoors") for mat in mesh.materials])[mesh.material]
    kind = np.where(outdoors, 2, np.where(mesh.two_sided, 3, glow.astype(np.int32))).astype(np.int32)
    order = geometry.order
    step = max(1, min(2048, m // (4 * threads) + 1))
    spans = [(a, min(a + step, m)) for a in range(0, m, step)]

    def gather(span: tuple[int, int]) -> None:
        _gather(
            span[0],
            span[1],
            mesh.node_pos,
            mesh.node_normal,
            mesh.node_two,
            geometry.boxes,
            geometry.links,
            geometry.planes,
            geometry.tree_shape,
            kind[order],
            pack[0],
            pack[1],
            pack[2],
            pack[3],
            sun_dir,
            sun_rad,
            LIGHT_SAMPLES,
            BOUNCE_RAYS,
            direct,
            hit,
            hit_u,
            hit_v,
            inside,
        )

    grids = np.unique(mesh.nodes[mesh.shape != TRIANGLE], axis=0)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(gather, spans))
        for base, nu, nv in grids:
            if inside[base : base + nu * nv].any():
                _fill_inside(base, nu, nv, inside, direct, 12)
        light = direct.copy()
        for _ in range(BOUNCES):
            indirect = np.zeros_like(direct)
            args = (
                hit,
                hit_u,
                hit_v,
                order,
                surfaces.look,
                surfaces.albedo,
                light,
                indirect,
            )
            list(pool.map(lambda s, a=args: _bounce(s[0], s[1], *a), spans))
            for base, nu, nv in grids:
                if inside[base : base + nu * nv].any():
                    _fill_inside(base, nu, nv, inside, indirect, 12)
                for _ in range(min(8, min(nu, nv) // 3)):
                    _smooth(base, nu, nv, indirect)
            light = direct + indirect
    return light.astype(np.float32)

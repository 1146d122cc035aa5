"""Small objects: books, vases, lamps, plants, rugs. They stand on z = 0 unless a height is given; metres."""

from __future__ import annotations

import colorsys

import numpy as np

from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import BLACK, STEEL
from panobench.rooms.mesh import LEAF, Material


def books(
    b: Builder,
    x0: float,
    x1: float,
    y: float,
    z: float,
    room: float,
    depth: float = 0.2,
) -> None:
    """A row of upright books on a board at height z, with spines near y, from x0 to about x1. room: height above it."""
    r = b.rng
    x = x0 + 0.01
    stop = x1 - (r.uniform(0.02, 0.3) * (x1 - x0) if r.uniform() < 0.5 else 0.02)
    while x < stop - 0.05:
        t, h = r.uniform(0.018, 0.055), min(room - 0.02, r.uniform(0.17, 0.3))
        d = depth * r.uniform(0.75, 1.0)
        if r.uniform() < 0.06:
            x += r.uniform(0.03, 0.1)
            continue
        tint = tuple(float(v) for v in r.uniform(0.7, 1.15) * r.uniform(0.92, 1.08, 3))
        k = int(r.integers(8))
        spine = Material(f"spines#{int(r.integers(4))}", 0.0, tint=tint)  # type: ignore[arg-type]
        _spine(b, x, t, y, z, h, spine, k)
        cover = Material("", tint=(0.3 * tint[0], 0.3 * tint[1], 0.33 * tint[2]))
        page = Material("", tint=(0.72, 0.68, 0.58))
        b.quad((x, y, z), (0, 0, h), (0, -d, 0), cover, spacing=1)  # the cover towards -x
        b.quad((x + t, y, z), (0, -d, 0), (0, 0, h), cover, spacing=1)
        b.quad((x, y - d, z + h), (t, 0, 0), (0, d, 0), page, spacing=1)
        x += t + 0.001


def _spine(b: Builder, x: float, t: float, y: float, z: float, h: float, m: Material, k: int) -> None:
    b.quad((x + t, y, z), (-t, 0, 0), (0, 0, h), m, spacing=1, uv=((k + 0.02) / 8, 0.96 / 8, 0.0, 1.0, 0.0, -1.0))


def knick_knack(b: Builder, x: float, y: float, z: float) -> None:
    """A random small object: a vase, a box, a ball or a mug."""
    r = b.rng
    c = 255 * np.clip(colorsys.hsv_to_rgb(r.uniform(), r.uniform(0.08, 0.62), r.uniform(0.25, 0.92)), 0, 1)
    m = Material(f"smooth:{c[0]:.0f},{c[1]:.0f},{c[2]:.0f}", 0.6)
    kind = r.integers(4)
    with b.at(x, y, z, r.uniform(0, 6.28)):
        if kind == 0:
            k = r.uniform(0.8, 1.3)
            prof = [
                (0.03, 0.0),
                (0.05, 0.03),
                (0.062, 0.08),
                (0.05, 0.13),
                (0.025, 0.17),
                (0.03, 0.2),
            ]
            b.lathe([(rr * k, zz * k) for rr, zz in prof], m, sides=14)
        elif kind == 1:
            s = r.uniform(0.05, 0.11, 3)
            b.box((-s[0] / 2, -s[1] / 2, 0), (s[0] / 2, s[1] / 2, s[2]), m, skip="z")
        elif kind == 2:
            q = r.uniform(0.035, 0.06)
            b.blob((0, 0, q), (q, q, q), m, square=1.0, rows=8, sides=12)
        else:
            b.lathe([(0.038, 0.0), (0.04, 0.095)], m, sides=12)
            b.disc((0, 0, 0.085), 0.038, Material("", tint=(0.08, 0.04, 0.02)))
            b.tube(
                [(0.04, 0, 0.08), (0.068, 0, 0.07), (0.068, 0, 0.03), (0.04, 0, 0.02)],
                0.006,
                m,
            )


def desk_lamp(b: Builder) -> None:
    """A jointed lamp on a round foot."""
    b.cylinder((0, 0, 0), 0.08, 0.02, BLACK)
    b.tube([(0, 0, 0.02), (-0.05, -0.02, 0.24)], 0.008, STEEL)
    b.tube([(-0.05, -0.02, 0.24), (0.1, 0.1, 0.42)], 0.008, STEEL)
    with b.at(0.12, 0.12, 0.36):
        b.lathe([(0.075, 0.0), (0.05, 0.06), (0.02, 0.09)], BLACK, sides=14)
        b.disc((0, 0, 0.004), 0.07, Material("", emission=(3, 2.7, 2.2)), up=False)


def plant(b: Builder, size: float = 1.0) -> None:
    """A pot with arching leaves."""
    r = b.rng
    pot = Material("smooth:176,92,58" if r.uniform() < 0.6 else "smooth:210,208,200", 0.8)
    k = size
    b.lathe(
        [
            (0.11 * k, 0.0),
            (0.15 * k, 0.24 * k),
            (0.165 * k, 0.24 * k),
            (0.165 * k, 0.29 * k),
            (0.14 * k, 0.29 * k),
        ],
        pot,
        sides=18,
    )
    b.disc((0, 0, 0.27 * k), 0.145 * k, Material("carpet:64,48,36", 1.0))
    green = Material("leaf", 0.0)
    for _ in range(int(r.integers(14, 22))):
        a, reach, rise = (
            r.uniform(0, 2 * np.pi),
            r.uniform(0.12, 0.34) * k,
            r.uniform(0.3, 0.75) * k,
        )
        base = np.array([0.03 * np.cos(a), 0.03 * np.sin(a), 0.27 * k])
        out = np.array([np.cos(a), np.sin(a), 0.0])
        mid = base + out * reach * 0.45 + [0, 0, rise]
        tip = base + out * reach * 1.5 + [0, 0, rise * r.uniform(0.55, 0.95)]
        b.tube(
            [base, (base + mid) / 2 + [0, 0, 0.04 * k], mid],
            0.004 * k,
            Material("", tint=(0.06, 0.13, 0.04)),
            sides=4,
        )
        side = np.cross(out, [0, 0, 1.0]) * r.uniform(0.09, 0.15) * k
        shade = r.uniform(0.7, 1.2)
        b.quad(
            mid - side / 2,
            tip - mid,
            side,
            green.tinted(shade, shade, shade),
            shape=LEAF,
            two_sided=True,
            spacing=0.2,
        )


def floor_lamp(b: Builder, shade: Material, power: float = 5.0) -> None:
    """A standing lamp with a lit fabric shade."""
    b.cylinder((0, 0, 0), 0.14, 0.025, BLACK)
    b.tube([(0, 0, 0.02), (0, 0, 1.45)], 0.011, STEEL)
    with b.at(0, 0, 1.4):
        glow = 0.42 * power
        lit = Material(shade.texture, shade.scale, emission=(glow, glow * 0.8, glow * 0.52))
        b.lathe([(0.2, 0.0), (0.14, 0.27)], lit, sides=20)
        b.lathe(
            [(0.135, 0.265), (0.195, 0.005)],
            Material("", emission=(power, power * 0.85, power * 0.6)),
            sides=20,
        )
        for sign in (1, -1):
            s = 0.2
            p = np.array([power * 1.3, power * 1.05, power * 0.7])
            if sign > 0:
                b.rect_light((-s / 2, -s / 2, -0.01), (0, s, 0), (s, 0, 0), p)
            else:
                b.rect_light((-s / 2, -s / 2, 0.28), (s, 0, 0), (0, s, 0), p)


def rug(b: Builder, w: float, d: float, name: str) -> None:
    """A flat rug centred at the origin, w along x."""
    h = 0.012
    b.box(
        (-w / 2, -d / 2, 0),
        (w / 2, d / 2, h),
        Material("carpet:120,100,80", 1.0),
        skip="zZ",
    )
    b.quad((-w / 2, -d / 2, h), (w, 0, 0), (0, d, 0), Material(name, 0.0), spacing=0.05)

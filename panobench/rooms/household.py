"""Furniture for bedroom, kitchen, dining and living room. Local frame as in ``furniture``."""

from __future__ import annotations

import numpy as np

from panobench.rooms import furniture as fu
from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import BLACK, BRASS, CABLE, STEEL
from panobench.rooms.mesh import DISC, Material

LINEN = Material("fabric:226,224,216", 0.8)


def bed(b: Builder, w: float, frame: Material, cover: Material) -> None:
    """A bed, head at the wall, with duvet and pillows; 2.1 m long."""
    b.box((-w / 2 - 0.04, 0.02, 0), (w / 2 + 0.04, 0.06, 0.95), frame, grain=0)
    b.box((-w / 2 - 0.02, 0.06, 0.12), (w / 2 + 0.02, 2.06, 0.28), frame, skip="y", grain=1)
    fu.legs(b, w, 2.0, 0.12, 0.06, frame, y0=0.06)
    b.blob((0, 1.06, 0.4), (w / 2, 0.98, 0.13), LINEN, square=0.22, rows=8, sides=32)
    b.blob((0, 1.28, 0.47), (w / 2 + 0.05, 0.82, 0.12), cover, square=0.3, rows=9, sides=44, dent=0.025)
    for x in (-w / 4, w / 4) if w > 1.2 else (0.0,):
        with b.at(x, 0.3, 0.58, b.rng.uniform(-0.1, 0.1)):
            b.blob((0, 0, 0), (0.33, 0.2, 0.085), LINEN, square=0.5, rows=8, sides=24, dent=0.02)


def wardrobe(b: Builder, w: float, h: float, m: Material, mirror: bool = False) -> None:
    """A wardrobe: tall doors with long handles; one may have a dull mirror."""
    d = 0.58
    b.box((-w / 2, 0, 0), (w / 2, d, h), m, skip="yz", grain=2)
    n = max(2, round(w / 0.5))
    dw = w / n
    for k in range(n):
        x = -w / 2 + k * dw
        b.box((x + 0.004, d, 0.06), (x + dw - 0.004, d + 0.018, h - 0.02), m, skip="y", grain=2)
        hx = x + (dw - 0.06 if k % 2 == 0 else 0.05)
        b.tube([(hx, d + 0.018, 0.9), (hx, d + 0.05, 0.92), (hx, d + 0.05, 1.2), (hx, d + 0.018, 1.22)], 0.007, STEEL)
        if mirror and k == n // 2:
            glass = Material("", tint=(0.05, 0.055, 0.055), gloss=0.75)
            b.quad((x + dw - 0.06, d + 0.02, 0.3), (0.12 - dw, 0, 0), (0, 0, h - 0.6), glass)


def kitchen(b: Builder, w: float, front: Material, top: Material) -> None:
    """A kitchen: base units with worktop, sink and hob, tiled splashback, upper cabinets, objects on the worktop."""
    d, h = 0.6, 0.9
    b.box((-w / 2, 0, 0.1), (w / 2, d, h - 0.035), front, skip="yZ")
    b.box((-w / 2, 0.04, 0), (w / 2, d - 0.06, 0.1), BLACK, skip="yzZ")
    b.box((-w / 2 - 0.01, 0, h - 0.035), (w / 2 + 0.01, d + 0.03, h), top, skip="y", grain=0)
    n = max(3, round(w / 0.6))
    dw = w / n
    for k in range(n):
        x = -w / 2 + k * dw
        rows = ((0.12, 0.84),) if k % 3 else ((0.12, 0.36), (0.37, 0.6), (0.61, 0.84))
        for z0, z1 in rows:
            b.box((x + 0.006, d, z0), (x + dw - 0.006, d + 0.018, z1), front, skip="y", grain=2)
            z = z1 - 0.05
            b.tube([(x + 0.12, d + 0.03, z), (x + dw - 0.12, d + 0.03, z)], 0.006, STEEL)
    splash = Material("tiles:214,218,214", 1.2)
    b.quad((w / 2, 0.006, h), (-w, 0, 0), (0, 0, 0.52), splash, origin=(0, 0))
    for k in range(n):
        if k == n // 2:
            continue
        x = -w / 2 + k * dw
        b.box((x + 0.003, 0, 1.42), (x + dw - 0.003, 0.34, 2.12), front, skip="y", grain=2)
        b.tube([(x + dw - 0.06, 0.36, 1.46), (x + dw - 0.06, 0.36, 1.6)], 0.006, STEEL)
    # Sink with tap, hob, hood.
    sx = -w / 2 + dw * (n // 2 + 0.5)
    b.box((sx - 0.26, 0.1, h), (sx + 0.26, 0.52, h + 0.006), STEEL, skip="z")
    b.quad((sx - 0.2, 0.15, h + 0.008), (0.4, 0, 0), (0, 0.3, 0), BLACK)
    b.tube([(sx, 0.12, h), (sx, 0.12, h + 0.26), (sx, 0.2, h + 0.31), (sx, 0.28, h + 0.25)], 0.012, STEEL)
    hx = -w / 2 + dw * 0.9
    b.box((hx - 0.28, 0.06, h), (hx + 0.28, 0.54, h + 0.008), BLACK, skip="z")
    with b.at(hx + 0.1, 0.24, h + 0.008):
        b.lathe([(0.1, 0), (0.105, 0.12), (0.1, 0.12), (0.095, 0.02), (0.0, 0.02)], STEEL, sides=18)
        b.tube([(0.1, 0, 0.1), (0.28, 0.05, 0.11)], 0.01, BLACK)
    for x in np.arange(-w / 2 + 0.25, w / 2 - 0.2, 0.33):
        if abs(x - sx) > 0.35 and abs(x - hx) > 0.4 and b.rng.uniform() < 0.8:
            small.knick_knack(b, x, 0.2 + b.rng.uniform(0, 0.15), h)


def fridge(b: Builder) -> None:
    """A fridge-freezer with notes on it."""
    body = Material("smooth:222,224,226", 1.5)
    b.box((-0.3, 0.02, 0.03), (0.3, 0.62, 1.8), body, skip="yz")
    b.box((-0.298, 0.62, 0.04), (0.298, 0.66, 0.62), body, skip="y")
    b.box((-0.298, 0.62, 0.635), (0.298, 0.66, 1.795), body, skip="y")
    for z0, z1 in ((0.35, 0.58), (0.7, 1.1)):
        b.tube([(0.25, 0.66, z0), (0.25, 0.7, z0 + 0.02), (0.25, 0.7, z1 - 0.02), (0.25, 0.66, z1)], 0.01, STEEL)
    for k in range(4):
        x, z = b.rng.uniform(-0.2, 0.1), b.rng.uniform(1.0, 1.6)
        b.quad((x + 0.1, 0.662, z), (-0.1, 0, 0), (0, 0, 0.13), Material(f"poster#{k}", 0.0))


def dining(b: Builder, w: float, d: float, wood: Material, seat: Material, chairs: int = 4) -> None:
    """A table centred at the origin with chairs round it and objects on it."""
    with b.at(0, -d / 2):
        fu.table(b, w, d, 0.75, wood)
    spots = [
        (-w / 4, -d / 2 - 0.32, 0.0),
        (w / 4, d / 2 + 0.32, np.pi),
        (w / 4, -d / 2 - 0.3, 0.0),
        (-w / 4, d / 2 + 0.34, np.pi),
    ]
    for x, y, yaw in spots[:chairs]:
        with b.at(x, y, 0, yaw + b.rng.uniform(-0.25, 0.25)):
            fu.chair(b, wood, seat)
    for x in np.arange(-w / 2 + 0.2, w / 2 - 0.1, 0.3):
        small.knick_knack(b, x, b.rng.uniform(-0.5, 0.5) * (d - 0.3), 0.75)
    c = Material("smooth:216,208,196", 0.6)
    with b.at(0.0, 0.0, 0.75):
        b.lathe([(0.05, 0.0), (0.13, 0.05), (0.15, 0.085), (0.145, 0.085), (0.12, 0.05), (0.0, 0.012)], c, sides=20)
        for _ in range(5):
            x, y = b.rng.uniform(-0.07, 0.07, 2)
            col = [(170, 40, 30), (200, 150, 40), (90, 130, 40)][int(b.rng.integers(3))]
            b.blob(
                (x, y, 0.08),
                (0.037, 0.037, 0.035),
                Material(f"smooth:{col[0]},{col[1]},{col[2]}", 0.3),
                square=1.0,
                rows=7,
                sides=10,
            )


def coffee_table(b: Builder, w: float, d: float, wood: Material) -> None:
    """A low table centred at the origin with books and a cup."""
    with b.at(0, -d / 2):
        fu.table(b, w, d, 0.42, wood, t=0.03)
    z = 0.42
    for k in range(3):
        with b.at(-w / 4, 0, z + 0.028 * k, b.rng.uniform(-0.4, 0.4)):
            tint = tuple(float(v) for v in b.rng.uniform(0.1, 0.7, 3))
            b.box((-0.13, -0.09, 0), (0.13, 0.09, 0.028), Material("", tint=tint), skip="z")  # type: ignore[arg-type]
    b.quad((-w / 4 - 0.12, -0.085, z + 0.0845), (0.24, 0, 0), (0, 0.17, 0), Material("landscape#5", 0.0))
    small.knick_knack(b, w / 4, 0.05, z)
    small.knick_knack(b, 0.02, -0.1, z)


def television(b: Builder, w: float, wood: Material) -> None:
    """A screen on a low board with cables behind."""
    fu.cabinet(b, w, 0.5, 0.42, wood, doors=3, things=False)
    z = 0.5
    b.box((-0.55, 0.16, z + 0.06), (0.55, 0.2, z + 0.7), BLACK)
    b.quad((0.535, 0.201, z + 0.075), (-1.07, 0, 0), (0, 0, 0.61), Material("", tint=(0.012, 0.012, 0.014), gloss=0.06))
    b.box((-0.2, 0.1, z), (0.2, 0.28, z + 0.015), BLACK, skip="z")
    b.box((-0.04, 0.16, z + 0.015), (0.04, 0.19, z + 0.06), BLACK)
    small.knick_knack(b, w / 2 - 0.15, 0.2, z)
    s = np.linspace(0, 1, 8)
    for k in range(2):
        y = 0.03 + 0.02 * k
        b.tube(
            np.stack([0.62 + 0.2 * s * (1 + k), y + 0 * s, z + 0.3 - 0.6 * s - 0.12 * np.sin(np.pi * s)], axis=-1),
            0.004,
            CABLE,
            sides=5,
        )


def armchair(b: Builder, cover: Material) -> None:
    """An upholstered chair facing +y."""
    b.box((-0.36, 0.08, 0.1), (0.36, 0.8, 0.28), cover, skip="zZ")
    for x in (-0.36, 0.36):
        b.blob((x, 0.44, 0.36), (0.085, 0.4, 0.24), cover, square=0.35, rows=8, sides=20)
    b.blob((0, 0.48, 0.34), (0.29, 0.34, 0.11), cover, square=0.35, rows=8, sides=24, dent=0.02)
    b.blob((0, 0.14, 0.6), (0.34, 0.12, 0.36), cover, square=0.4, rows=10, sides=24)
    fu.legs(b, 0.7, 0.7, 0.1, 0.05, BLACK, y0=0.1)


def boxes(b: Builder, count: int) -> None:
    """A stack of cardboard boxes in about 0.9 x 0.5 m."""
    card = Material("carpet:172,132,88", 1.2)
    tops: list[tuple[float, float, float]] = []
    for k in range(count):
        s = b.rng.uniform(0.25, 0.42, 3)
        if k < 2 or not tops:
            x, z = -0.25 + 0.47 * k, 0.0
        else:
            x, z, _ = tops[int(b.rng.integers(len(tops)))]
        with b.at(x, 0.26, z, b.rng.uniform(-0.15, 0.15)):
            b.box((-s[0] / 2, -s[1] / 2, 0), (s[0] / 2, s[1] / 2, s[2]), card, skip="z")
            b.quad((0.05, s[1] / 2 + 0.001, s[2] * 0.4), (-0.13, 0, 0), (0, 0, 0.09), Material(f"poster#{k}", 0.0))
            b.quad((-0.025, -s[1] / 2, s[2] + 0.001), (0.05, 0, 0), (0, s[1], 0), Material("smooth:196,170,120", 0.6))
        tops = [t for t in tops if t[:2] != (x, z)]
        tops.append((x, z + float(s[2]), 0.0))


def clock(b: Builder, x: float, z: float, r: float = 0.16) -> None:
    """A round wall clock (wall frame)."""
    face = Material("smooth:240,238,232", 0.5)
    a = np.linspace(0, 2 * np.pi, 25)
    a[-1] = 0.0
    ring = [
        np.stack([x - q * np.cos(a), np.full(25, y), z + q * np.sin(a)], axis=-1)
        for q, y in ((r, 0.0), (r, 0.04), (r * 0.9, 0.04), (r * 0.88, 0.025))
    ]
    b.grid(np.array(ring), BLACK, wrap=(False, True))
    b.quad((x + r, 0.022, z - r), (-2 * r, 0, 0), (0, 0, 2 * r), face, shape=DISC)
    for k in range(12):
        t = np.pi * k / 6
        p = np.array([x + 0.74 * r * np.sin(t), 0.024, z + 0.74 * r * np.cos(t)])
        b.tube([p, p + 0.12 * r * np.array([np.sin(t), 0, np.cos(t)])], 0.004, BLACK, sides=4)
    for t, length in ((b.rng.uniform(0, 6.28), 0.5), (b.rng.uniform(0, 6.28), 0.7)):
        b.tube([(x, 0.028, z), (x + length * r * np.sin(t), 0.028, z + length * r * np.cos(t))], 0.005, BLACK, sides=4)


def coat_rack(b: Builder, x: float, coats: list[Material]) -> None:
    """A rail with hooks and coats (wall frame)."""
    b.box((x - 0.5, 0, 1.62), (x + 0.5, 0.02, 1.72), Material("oak", 1.0), skip="y", grain=0)
    for k in range(5):
        q = x - 0.4 + 0.2 * k
        b.tube([(q, 0.02, 1.66), (q, 0.08, 1.65), (q, 0.09, 1.69)], 0.007, BRASS)
    for k, m in enumerate(coats):
        with b.at(x - 0.4 + 0.4 * k, 0.1, 1.2):
            b.blob((0, 0, 0), (0.2, 0.07, 0.47), m, square=0.6, rows=12, sides=24, dent=0.09)


def floor_cable(b: Builder, points: np.ndarray) -> None:
    """A cable on the floor through (x, y) points (N, 2), with a power strip at its end."""
    t = np.linspace(0, len(points) - 1, 8 * len(points))
    k = np.arange(len(points))
    x, y = np.interp(t, k, points[:, 0]), np.interp(t, k, points[:, 1])
    x, y = x + 0.05 * np.sin(5 * t), y + 0.05 * np.cos(4 * t)
    b.tube(np.stack([x, y, np.full_like(x, 0.008)], axis=-1), 0.006, CABLE, sides=5)
    b.box(
        (x[-1] - 0.12, y[-1] - 0.03, 0),
        (x[-1] + 0.12, y[-1] + 0.03, 0.04),
        Material("smooth:225,225,222", 0.5),
        skip="z",
    )

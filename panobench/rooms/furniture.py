"""Furniture. Local frame: the back at y = 0, the front towards +y, x centred, the floor at z = 0; metres."""

from __future__ import annotations

import numpy as np

from panobench.rooms import small
from panobench.rooms.builder import Builder
from panobench.rooms.fixtures import BLACK, BRASS, CABLE, STEEL
from panobench.rooms.mesh import Material


def legs(
    b: Builder,
    w: float,
    d: float,
    h: float,
    t: float,
    m: Material,
    y0: float = 0.0,
    inset: float = 0.0,
) -> None:
    """Four square legs under a w x d top."""
    for x in (-w / 2 + inset, w / 2 - t - inset):
        for y in (y0 + inset, y0 + d - t - inset):
            b.box((x, y, 0), (x + t, y + t, h), m, skip="zZ")


def table(b: Builder, w: float, d: float, h: float, m: Material, t: float = 0.035) -> None:
    """A table: top, apron and legs; y from 0 to d."""
    b.box((-w / 2, 0, h - t), (w / 2, d, h), m, grain=0)
    legs(b, w, d, h - t, 0.06, m, inset=0.03)
    a = 0.07
    b.box((-w / 2 + 0.05, 0.05, h - t - a), (w / 2 - 0.05, 0.07, h - t), m, skip="Z")
    b.box(
        (-w / 2 + 0.05, d - 0.07, h - t - a),
        (w / 2 - 0.05, d - 0.05, h - t),
        m,
        skip="Z",
    )


def chair(b: Builder, wood: Material, seat: Material) -> None:
    """A dining chair whose front faces +y; seat centred at y = 0.22."""
    w, d, h = 0.44, 0.44, 0.45
    for x in (-w / 2, w / 2 - 0.035):
        b.box((x, d - 0.035, 0), (x + 0.035, d, h), wood, skip="zZ")
        b.box((x, 0, 0), (x + 0.035, 0.035, 0.92), wood, skip="z")
    b.blob(
        (0, d / 2, h + 0.015),
        (w / 2 + 0.01, d / 2 + 0.01, 0.035),
        seat,
        square=0.35,
        rows=6,
        sides=20,
    )
    for z in (0.6, 0.72, 0.84):
        b.box(
            (-w / 2 + 0.035, 0.008, z),
            (w / 2 - 0.035, 0.026, z + 0.055),
            wood,
            skip="xX",
        )
    for x in (-w / 2 + 0.008, w / 2 - 0.026):
        b.box((x, 0.035, 0.2), (x + 0.018, d - 0.035, 0.23), wood, skip="yY")


def office_chair(b: Builder, cover: Material) -> None:
    """A swivel chair facing +y."""
    for k in range(5):
        a = 2 * np.pi * k / 5 + 0.3
        c, s = np.cos(a), np.sin(a)
        b.tube([(0, 0.25, 0.1), (0.28 * c, 0.25 + 0.28 * s, 0.06)], 0.02, BLACK)
        b.blob(
            (0.3 * c, 0.25 + 0.3 * s, 0.03),
            (0.025, 0.025, 0.03),
            BLACK,
            square=1.0,
            rows=5,
            sides=8,
        )
    b.cylinder((0, 0.25, 0.08), 0.025, 0.34, STEEL, caps="")
    b.blob((0, 0.25, 0.47), (0.25, 0.25, 0.055), cover, square=0.4, rows=7, sides=20)
    with b.at(0, 0.0, 0.86):
        b.blob((0, 0, 0), (0.22, 0.045, 0.28), cover, square=0.45, rows=9, sides=20)
    b.tube([(0, 0.2, 0.44), (0, -0.06, 0.5), (0, -0.06, 0.75)], 0.018, BLACK)
    for x in (-0.28, 0.28):
        b.tube([(x * 0.8, 0.25, 0.45), (x, 0.25, 0.5), (x, 0.22, 0.66)], 0.014, BLACK)
        b.box((x - 0.03, 0.1, 0.66), (x + 0.03, 0.36, 0.685), BLACK)


def bookshelf(
    b: Builder,
    w: float,
    h: float,
    m: Material,
    shelves: int = 5,
    d: float = 0.28,
    fill: float = 0.85,
) -> None:
    """Open shelves with books, boxes and small things."""
    t = 0.025
    b.box((-w / 2, 0, 0), (-w / 2 + t, d, h), m, skip="z")
    b.box((w / 2 - t, 0, 0), (w / 2, d, h), m, skip="z")
    b.quad((w / 2 - t, 0.012, 0), (2 * t - w, 0, 0), (0, 0, h), m, along_v=True)
    pitch = (h - 0.08) / shelves
    for k in range(shelves + 1):
        z = 0.06 + k * pitch
        b.box((-w / 2 + t, 0.012, z - t), (w / 2 - t, d - 0.005, z), m, skip="xXy")
        if k == shelves:
            break
        u = b.rng.uniform()
        if u < fill:
            small.books(b, -w / 2 + t, w / 2 - t, d - b.rng.uniform(0.02, 0.06), z, pitch - t)
        else:
            for x in np.arange(-w / 2 + 0.16, w / 2 - 0.12, 0.24):
                small.knick_knack(b, x, d / 2, z)


def cabinet(
    b: Builder,
    w: float,
    h: float,
    d: float,
    m: Material,
    doors: int = 3,
    things: bool = True,
) -> None:
    """A sideboard with doors, knobs and short legs."""
    b.box((-w / 2, 0, 0.1), (w / 2, d, h), m, skip="y", grain=0)
    legs(b, w, d, 0.1, 0.05, m, inset=0.02)
    dw = (w - 0.04) / doors
    for k in range(doors):
        x0 = -w / 2 + 0.02 + k * dw
        b.box(
            (x0 + 0.008, d, 0.13),
            (x0 + dw - 0.008, d + 0.016, h - 0.05),
            m,
            skip="y",
            grain=2,
        )
        b.blob(
            (x0 + (0.06 if k % 2 else dw - 0.06), d + 0.035, h * 0.55),
            (0.014, 0.02, 0.014),
            BRASS,
            square=1.0,
            rows=5,
            sides=8,
        )
    if things:
        for x in np.arange(-w / 2 + 0.2, w / 2 - 0.1, 0.35):
            if b.rng.uniform() < 0.75:
                small.knick_knack(b, x, d / 2, h)


def desk(b: Builder, w: float, d: float, m: Material, lamp: bool = True) -> None:
    """A desk with drawers, screen, keyboard, papers, lamp and hanging cables."""
    h = 0.74
    b.box((-w / 2, 0, h - 0.03), (w / 2, d, h), m, grain=0)
    b.box(
        (w / 2 - 0.42, 0.03, 0.02),
        (w / 2 - 0.02, d - 0.04, h - 0.03),
        m,
        skip="zZ",
        grain=0,
    )
    for k in range(3):
        z = 0.05 + 0.22 * k
        b.box(
            (w / 2 - 0.41, d - 0.04, z),
            (w / 2 - 0.03, d - 0.025, z + 0.21),
            m,
            skip="y",
            grain=0,
        )
        b.box(
            (w / 2 - 0.28, d - 0.025, z + 0.13),
            (w / 2 - 0.16, d - 0.012, z + 0.145),
            STEEL,
            skip="y",
        )
    for y in (0.03, d - 0.08):
        b.box((-w / 2 + 0.03, y, 0), (-w / 2 + 0.08, y + 0.05, h - 0.03), m, skip="zZ")
    b.box(
        (-w / 2 + 0.08, 0.04, 0.35),
        (w / 2 - 0.42, 0.055, h - 0.03),
        m,
        skip="Z",
        grain=0,
    )
    # The screen and its cables.
    b.box((-0.3, 0.18, h + 0.12), (0.3, 0.21, h + 0.48), BLACK)
    b.quad(
        (0.285, 0.211, h + 0.135),
        (-0.57, 0, 0),
        (0, 0, 0.33),
        Material("screen", 0.0, emission=(0.9, 0.9, 0.95)),
    )
    b.box((-0.03, 0.16, h), (0.03, 0.18, h + 0.3), BLACK)
    b.box((-0.12, 0.1, h), (0.12, 0.28, h + 0.012), BLACK)
    b.box(
        (-0.22, 0.38, h),
        (0.22, 0.52, h + 0.018),
        Material("check:70,70,74", 0.24),
        skip="z",
    )
    b.blob((0.31, 0.45, h + 0.012), (0.03, 0.05, 0.02), BLACK, square=0.8, rows=6, sides=10)
    s = np.linspace(0, 1, 9)
    for x0, x1 in ((0.05, 0.22), (-0.06, -0.3)):
        sag = 0.5 * s + 0.25 * np.sin(np.pi * s)
        b.tube(
            np.stack(
                [x0 + (x1 - x0) * s, 0.1 - 0.08 * s, h + 0.2 - sag * (h + 0.15)],
                axis=-1,
            ),
            0.004,
            CABLE,
            sides=5,
        )
    for k in range(3):
        with b.at(
            -w / 2 + 0.2 + 0.06 * k,
            d * 0.55 + 0.05 * k,
            h + 0.002 + 0.003 * k,
            b.rng.uniform(-0.5, 0.5),
        ):
            b.quad(
                (-0.1, -0.14, 0),
                (0.21, 0, 0),
                (0, 0.297, 0),
                Material(f"poster#{k}", 0.0),
            )
    small.knick_knack(b, w / 2 - 0.15, d * 0.6, h)
    if lamp:
        with b.at(-w / 2 + 0.16, 0.14, h):
            small.desk_lamp(b)


def sofa(b: Builder, w: float, cover: Material, cushions: list[Material]) -> None:
    """A sofa: seats, arms, back and loose cushions; 0.9 m deep."""
    d = 0.88
    with b.at(0, 0.05):
        b.box((-w / 2 + 0.05, 0.05, 0.1), (w / 2 - 0.05, d - 0.04, 0.3), cover, skip="zZ")
        for x in (-w / 2 + 0.1, w / 2 - 0.1):
            b.blob(
                (x, d / 2, 0.34),
                (0.11, d / 2, 0.25),
                cover,
                square=0.35,
                rows=9,
                sides=24,
            )
        n = max(1, round((w - 0.4) / 0.75))
        sw = (w - 0.42) / n
        for k in range(n):
            x = -w / 2 + 0.21 + sw * (k + 0.5)
            b.blob(
                (x, 0.52, 0.36),
                (sw / 2 + 0.004, 0.34, 0.1),
                cover,
                square=0.32,
                rows=8,
                sides=28,
                dent=0.02,
            )
            b.blob(
                (x, 0.17, 0.62),
                (sw / 2 + 0.004, 0.13, 0.27),
                cover,
                square=0.36,
                rows=10,
                sides=28,
                dent=0.03,
            )
        legs(b, w - 0.1, d - 0.1, 0.1, 0.05, BLACK, y0=0.05)
        for m in cushions:
            x = b.rng.uniform(-w / 2 + 0.4, w / 2 - 0.4)
            with b.at(x, 0.37, 0.6, b.rng.uniform(-0.25, 0.25)):
                b.blob(
                    (0, 0, 0),
                    (0.21, 0.085, 0.2),
                    m,
                    square=0.55,
                    rows=9,
                    sides=20,
                    dent=0.02,
                )

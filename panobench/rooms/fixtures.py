"""Parts of the building: walls with openings, doors, windows, skirting, lamps, radiators, curtains, pictures.

Wall frame: x runs along the wall, y = 0 is its surface, +y points into the room, z up. Seen from inside, +x is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from panobench.rooms.builder import Builder
from panobench.rooms.mesh import Material

WHITE = Material("smooth:232,230,224", 2.5)
FRAME = Material("smooth:238,237,233", 1.5)
SILL = Material("walnut", 1.0)
STEEL = Material("metal:150,152,156", 0.5)
BRASS = Material("metal:176,140,70", 0.5)
BLACK = Material("metal:34,34,36", 0.5)
LAMPSHADE = Material("fabric:224,206,170", 0.8)
CABLE = Material("", tint=(0.02, 0.02, 0.022))


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, in wall coordinates, metres.

    kind:  "window", "door" (closed), "doorway" (open), or "passage": a doorway whose reveals the other room builds.
    depth: of the reveal; 0: the room's own.
    """

    kind: str
    x0: float
    x1: float
    z0: float
    z1: float
    depth: float = 0.0


def wall(
    b: Builder,
    length: float,
    height: float,
    material: Material,
    openings: list[Opening],
    depth: float,
) -> None:
    """The wall's surface with holes, and the reveals of the holes, ``depth`` deep."""
    group = b.new_group()
    cuts = sorted({0.0, length, *(o.x0 for o in openings), *(o.x1 for o in openings)})

    def piece(x0: float, x1: float, z0: float, z1: float) -> None:
        if x1 - x0 > 1e-6 and z1 - z0 > 1e-6:
            b.quad(
                (x1, 0, z0),
                (x0 - x1, 0, 0),
                (0, 0, z1 - z0),
                material,
                group=group,
                origin=(-x1, z0),
                spacing=1.15 * b.node_spacing,
            )

    for x0, x1 in pairwise(cuts):
        top = 0.0
        for hole in sorted((o for o in openings if o.x0 <= x0 + 1e-9 and o.x1 >= x1 - 1e-9), key=lambda o: o.z0):
            piece(x0, x1, top, hole.z0)
            top = hole.z1
        piece(x0, x1, top, height)
    for o in openings:
        if o.kind in ("door", "passage"):
            continue
        d, w, h = o.depth or depth, o.x1 - o.x0, o.z1 - o.z0
        reveal = FRAME if o.kind == "window" else material
        b.quad((o.x0, -d, o.z0), (0, d, 0), (0, 0, h), reveal)
        b.quad((o.x1, 0, o.z0), (0, -d, 0), (0, 0, h), reveal)
        b.quad((o.x0, -d, o.z1), (0, d, 0), (w, 0, 0), reveal)
        b.quad((o.x0, -d, o.z0), (w, 0, 0), (0, d, 0), reveal if o.kind == "window" else SILL)


def skirting(
    b: Builder,
    length: float,
    openings: list[Opening],
    material: Material,
    height: float = 0.08,
) -> None:
    """A board along the foot of the wall, interrupted at doors."""
    x: float = 0.0
    for o in [*sorted((o for o in openings if o.z0 < 0.05), key=lambda o: o.x0), None]:
        end = length if o is None else o.x0 - 0.06
        if end - x > 0.02:
            b.box((x, 0, 0), (end, 0.014, height), material, skip="yz")
        x = length if o is None else o.x1 + 0.06


def casing(b: Builder, o: Opening, material: Material = FRAME, width: float = 0.06) -> None:
    """The trim round a door or doorway."""
    t = 0.018
    b.box((o.x0 - width, 0, o.z0), (o.x0, t, o.z1), material, skip="yz")
    b.box((o.x1, 0, o.z0), (o.x1 + width, t, o.z1), material, skip="yz")
    b.box((o.x0 - width, 0, o.z1), (o.x1 + width, t, o.z1 + width), material, skip="y")


def door(b: Builder, o: Opening, material: Material) -> None:
    """A closed door leaf with four panels, casing and handle."""
    casing(b, o)
    y = -0.03
    w, h = o.x1 - o.x0, o.z1
    b.quad((o.x1, y, 0), (-w, 0, 0), (0, 0, h), material, along_v=True)
    for x in (o.x0, o.x1):
        b.quad((x, y, 0), (0, -y, 0), (0, 0, h), FRAME) if x == o.x0 else b.quad((x, 0, 0), (0, y, 0), (0, 0, h), FRAME)
    b.quad((o.x0, y, h), (0, -y, 0), (w, 0, 0), FRAME)
    b.quad((o.x0, y, 0), (w, 0, 0), (0, -y, 0), material)
    for i in range(2):
        for z0, z1 in ((0.15, 0.85), (1.0, h - 0.15)):
            x0 = o.x0 + 0.1 + i * (w / 2 - 0.03)
            x1 = x0 + w / 2 - 0.17
            b.box((x0, y, z0), (x1, y + 0.012, z1), material, skip="y", grain=2)
    b.box((o.x0 + 0.05, y, 0.95), (o.x0 + 0.09, y + 0.01, 1.12), BRASS, skip="y")
    b.tube(
        [
            (o.x0 + 0.07, y, 1.04),
            (o.x0 + 0.07, y + 0.05, 1.04),
            (o.x0 + 0.19, y + 0.055, 1.04),
        ],
        0.009,
        BRASS,
    )


def backdrop(b: Builder, centre: float, width: float, sky: float, view: str) -> None:
    """What a wall's windows show: a lit picture 3.2 m behind it.

    It shines at 40% of ``sky``, the radiance that lights the room, because cameras compress highlights too.
    """
    shown = 0.4 * sky
    glow = Material(view, 0.0, emission=(shown, shown, shown))
    uv = (0.0, float(max(1, round(width / 15.0))), 0.0, 1.0, 0.0, -1.0)
    b.quad((centre + width / 2, -3.2, -4.6), (-width, 0, 0), (0, 0, 11.0), glow, spacing=4.0, uv=uv)


def window(b: Builder, o: Opening, depth: float, sky: float, panes: int = 2) -> None:
    """Frame, bars, sill, and the light that comes in. sky: radiance outside."""
    f, t, y = 0.055, 0.05, -depth * 0.6
    w, h = o.x1 - o.x0, o.z1 - o.z0
    b.box((o.x0, y - t / 2, o.z0), (o.x0 + f, y + t / 2, o.z1), FRAME, skip="xzZ")
    b.box((o.x1 - f, y - t / 2, o.z0), (o.x1, y + t / 2, o.z1), FRAME, skip="XzZ")
    b.box((o.x0 + f, y - t / 2, o.z0), (o.x1 - f, y + t / 2, o.z0 + f), FRAME, skip="xXz")
    b.box((o.x0 + f, y - t / 2, o.z1 - f), (o.x1 - f, y + t / 2, o.z1), FRAME, skip="xXZ")
    for k in range(1, panes):
        x = o.x0 + w * k / panes
        b.box(
            (x - 0.03, y - 0.02, o.z0 + f),
            (x + 0.03, y + 0.02, o.z1 - f),
            FRAME,
            skip="zZ",
        )
    z = o.z0 + h * 0.68
    b.box(
        (o.x0 + f, y - 0.012, z - 0.014),
        (o.x1 - f, y + 0.012, z + 0.014),
        FRAME,
        skip="xX",
    )
    if o.z0 > 0.3:
        b.box(
            (o.x0 - 0.08, 0, o.z0 - 0.035),
            (o.x1 + 0.08, 0.1, o.z0),
            Material("stone:214,210,200", 1.0),
            skip="y",
        )
    glow = sky * 0.95
    b.rect_light(
        (o.x1 - f, y - 0.03, o.z0 + f),
        (2 * f - w, 0, 0),
        (0, 0, h - 2 * f),
        (glow * 0.84, glow * 0.95, glow * 1.08),
    )


def curtains(b: Builder, o: Opening, material: Material, share: float = 0.24) -> None:
    """A rod and a pair of gathered curtains down to near the floor."""
    top, y = o.z1 + 0.16, 0.19
    b.tube([(o.x0 - 0.4, y, top), (o.x1 + 0.4, y, top)], 0.012, BRASS)
    w = (o.x1 - o.x0) * share + 0.26
    for x0, sign in ((o.x0 - 0.3, 1.0), (o.x1 + 0.3, -1.0)):
        n = 41
        s = np.linspace(0, 1, n)
        phase = b.rng.uniform(0, 6)
        rows = []
        for z, amp, gather in (
            (top - 0.01, 0.025, 0.92),
            (1.1, 0.05, 0.8),
            (0.05, 0.06, 1.0),
        ):
            wave = amp * np.sin(2 * np.pi * 6 * s + phase) + 0.4 * amp * np.sin(2 * np.pi * 2.3 * s + 2 * phase)
            rows.append(np.stack([x0 + sign * s * w * gather, y + wave, np.full(n, z)], axis=-1))
        b.grid(np.array(rows), material, two_sided=True)


def radiator(b: Builder, x: float, width: float, height: float = 0.5, z: float = 0.13) -> None:
    """A ribbed radiator under a window."""
    n = int(width / 0.06)
    paint = Material("smooth:226,226,222", 1.0)
    for k in range(n):
        x0 = x - width / 2 + k * width / n
        b.box(
            (x0, 0.04, z),
            (x0 + width / n * 0.72, 0.12, z + height),
            paint,
            skip="y",
            spacing=0.2,
        )
    b.box(
        (x - width / 2, 0.06, z + 0.03),
        (x + width / 2, 0.075, z + height - 0.03),
        paint,
        skip="y",
    )
    b.tube(
        [
            (x + width / 2, 0.08, z + 0.05),
            (x + width / 2 + 0.07, 0.08, z + 0.05),
            (x + width / 2 + 0.07, 0.08, 0),
        ],
        0.009,
        STEEL,
    )


def picture(
    b: Builder,
    x: float,
    z: float,
    w: float,
    h: float,
    image: str,
    frame: Material,
    gloss: float = 0.0,
) -> None:
    """A framed picture centred at (x, z) on the wall, with a passe-partout."""
    f, t = 0.03, 0.025
    x0, x1, z0, z1 = x - w / 2, x + w / 2, z - h / 2, z + h / 2
    b.box((x0 - f, 0, z0 - f), (x0, t, z1 + f), frame, skip="y")
    b.box((x1, 0, z0 - f), (x1 + f, t, z1 + f), frame, skip="y")
    b.box((x0, 0, z1), (x1, t, z1 + f), frame, skip="yxX")
    b.box((x0, 0, z0 - f), (x1, t, z0), frame, skip="yxX")
    m = 0.12 * min(w, h)
    b.quad(
        (x1, 0.010, z0),
        (-w, 0, 0),
        (0, 0, h),
        Material("", tint=(0.8, 0.78, 0.74), gloss=gloss),
    )
    b.quad(
        (x1 - m, 0.012, z0 + m),
        (2 * m - w, 0, 0),
        (0, 0, h - 2 * m),
        Material(image, 0.0, gloss=gloss),
    )


def ceiling_panel(b: Builder, x: float, y: float, z: float, w: float, d: float, power: float) -> None:
    """A flat lamp under the ceiling at height z. power: its radiance."""
    t = 0.05
    b.box(
        (x - w / 2 - 0.03, y - d / 2 - 0.03, z - t),
        (x + w / 2 + 0.03, y + d / 2 + 0.03, z),
        STEEL,
        skip="zZ",
    )
    b.quad((x - w / 2 - 0.03, y - d / 2 - 0.03, z - t), (0, d + 0.06, 0), (w + 0.06, 0, 0), STEEL)
    p = (x - w / 2, y - d / 2, z - t - 0.004)
    b.quad(p, (0, d, 0), (w, 0, 0), Material("", emission=(power, power * 0.96, power * 0.9)))
    b.rect_light((p[0], p[1], p[2] - 0.01), (0, d, 0), (w, 0, 0), np.array([1, 0.95, 0.88]) * power)


def pendant(
    b: Builder,
    x: float,
    y: float,
    ceiling: float,
    drop: float,
    radius: float,
    power: float,
    shade: Material,
) -> None:
    """A lampshade on a cable, lit from inside. power: radiance of the bulb."""
    z = ceiling - drop
    b.tube([(x, y, ceiling), (x, y, z + radius * 0.7)], 0.005, CABLE)
    b.cylinder((x, y, ceiling - 0.03), 0.05, 0.03, STEEL, caps="z")
    with b.at(x, y, z):
        prof = [
            (radius, 0.0),
            (radius * 0.96, radius * 0.25),
            (radius * 0.5, radius * 0.6),
            (radius * 0.12, radius * 0.72),
        ]
        b.lathe(prof, shade, sides=20)
        inner = Material("", emission=(power * 0.16, power * 0.15, power * 0.13))
        b.lathe([(r * 0.98, h - 0.004) for r, h in reversed(prof)], inner, sides=20)
        b.blob(
            (0, 0, radius * 0.25),
            (0.05, 0.05, 0.06),
            Material("", emission=(power * 1.2, power * 1.1, power)),
            square=1.0,
        )
        s = radius * 1.4
        b.rect_light(
            (-s / 2, -s / 2, -0.02),
            (0, s, 0),
            (s, 0, 0),
            np.array([1, 0.92, 0.8]) * power,
        )


def socket(b: Builder, x: float, z: float = 0.3) -> None:
    """A wall socket or light switch plate."""
    b.box((x - 0.04, 0, z - 0.04), (x + 0.04, 0.009, z + 0.04), FRAME, skip="y")
    b.box(
        (x - 0.02, 0.009, z - 0.02),
        (x + 0.02, 0.012, z + 0.02),
        Material("smooth:205,203,198", 0.5),
        skip="y",
    )

"""Surface textures: wood, plaster, brick, tiles, carpet, fabrics. Each function returns tileable linear RGB (H, W, 3).

The grain of wood runs along x. Docstrings give the scale, in metres per repeat, for which a texture is drawn.
"""

from __future__ import annotations

import numpy as np

from panobench.rooms.noise import (
    Field,
    cells,
    fractal,
    linear,
    ramp,
    smoothstep,
)


def _grid(size: int | tuple[int, int]) -> tuple[Field, Field]:
    h, w = (size, size) if isinstance(size, int) else size
    y, x = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(w) + 0.5) / w, indexing="ij")
    return y.astype(np.float32), x.astype(np.float32)


def _fibres(rng: np.random.Generator, size: int | tuple[int, int], warp: float = 1.0) -> Field:
    """The figure of wood, in about -1..1: growth rings cut at a shallow angle, and pores."""
    y, _ = _grid(size)
    slow = fractal(rng, size, beta=2.0, stretch=5.0, high=60)
    rings = (
        np.sin(2 * np.pi * (y * 9 + 0.55 * warp * slow)) * 0.45 + np.sin(2 * np.pi * (y * 23 + 1.6 * warp * slow)) * 0.2
    )
    pores = fractal(rng, size, beta=0.6, stretch=22.0, low=6)
    return np.asarray(rings + 0.3 * pores + 0.35 * slow, dtype=np.float32)


def wood(rng: np.random.Generator, dark: Field, light: Field) -> Field:
    """Plain wood; 1 m per repeat."""
    return ramp(0.5 + 0.26 * _fibres(rng, 512), dark, (dark + light) / 2, light)


def planks(
    rng: np.random.Generator,
    dark: Field,
    light: Field,
    rows: int = 24,
    contrast: float = 1.0,
) -> Field:
    """Floor boards; 3 m per repeat, boards 12 cm wide."""
    size = 1024
    y, x = _grid(size)
    row = np.minimum((y * rows).astype(np.int32), rows - 1)
    offset = rng.uniform(0, 1, rows)[row]
    per_row = rng.integers(2, 4, rows)[row]
    along = (x + offset) * per_row
    board = (row * 7 + np.floor(along).astype(np.int32) % per_row).astype(np.int32)
    ident = board % 512
    tone = rng.normal(0, 0.16 * contrast, 512).astype(np.float32)[ident]
    figure = _fibres(rng, size, 0.8)
    figure = np.roll(figure, 311, axis=0) * 0.5 + figure * 0.5
    shift = rng.integers(0, size, 512)[ident]
    cols = (np.arange(size)[None] + shift) % size
    rws = (np.arange(size)[:, None] + shift * 3) % size
    figure = figure[rws, cols]
    rgb = ramp(0.5 + tone + 0.17 * contrast * figure, dark, (dark + light) / 2, light)
    hue = rng.normal(0, 0.05, (512, 3)).astype(np.float32)[ident]
    fy, fx = np.abs((y * rows) % 1 - 0.5), np.abs(along % 1 - 0.5)
    gap = np.minimum(smoothstep(0.0, 0.035, 0.5 - fy), smoothstep(0.0, 0.004, 0.5 - fx))
    return np.asarray(rgb * (1 + hue) * (0.3 + 0.7 * gap)[..., None], dtype=np.float32)


def parquet(rng: np.random.Generator, dark: Field, light: Field) -> Field:
    """Basket weave parquet; 1.6 m per repeat, squares of 20 cm."""
    size, n, strips = 1024, 8, 5
    y, x = _grid(size)
    cy, cx = (y * n).astype(np.int32) % n, (x * n).astype(np.int32) % n
    across = (cy + cx) % 2 == 1
    ly, lx = (y * n) % 1, (x * n) % 1
    s = np.where(across, lx, ly)
    strip = np.minimum((s * strips).astype(np.int32), strips - 1)
    ident = (cy * n + cx) * strips + strip
    tone = rng.normal(0, 0.13, n * n * strips).astype(np.float32)[ident]
    figure = _fibres(rng, size, 0.7)
    figure = np.where(across, figure.T, figure)
    rgb = ramp(0.5 + tone + 0.15 * figure, dark, (dark + light) / 2, light)
    edge = np.minimum(
        0.5 - np.abs((s * strips) % 1 - 0.5),
        (0.5 - np.maximum(abs(lx - 0.5), abs(ly - 0.5))) * strips,
    )
    return np.asarray(rgb * (0.45 + 0.55 * smoothstep(0, 0.07, edge))[..., None], dtype=np.float32)


def plaster(rng: np.random.Generator, colour: Field, strength: float = 1.0) -> Field:
    """Painted plaster; 2.5 m per repeat: broad stains, roller texture, a few scratches."""
    broad = fractal(rng, 512, beta=1.6, high=40)
    fine = fractal(rng, 512, beta=0.55, low=20)
    blotch = smoothstep(0.4, 2.0, fractal(rng, 512, beta=1.4, high=90))
    value = 1 + strength * (0.03 * broad + 0.026 * fine - 0.055 * blotch)
    warm = fractal(rng, 512, beta=1.8, high=30)[..., None] * np.array([0.006, 0, -0.012], np.float32) * strength
    return np.asarray(colour * (value[..., None] + warm), dtype=np.float32)


def brick(rng: np.random.Generator, base: Field, mortar: Field) -> Field:
    """A brick wall of 6 x 20 bricks; 1.5 m per repeat."""
    size, nx, ny = 1024, 6, 20
    y, x = _grid(size)
    x = x + 0.0012 * fractal(rng, size, beta=1.2)
    y = y + 0.0012 * fractal(rng, size, beta=1.2)
    row = np.floor(y * ny).astype(np.int32) % ny
    along = x * nx + 0.5 * (row % 2)
    ident = row * nx + np.floor(along).astype(np.int32) % nx
    tone = rng.normal(1, 0.2, nx * ny).astype(np.float32)[ident]
    hue = rng.normal(0, 0.08, (nx * ny, 3)).astype(np.float32)[ident]
    rough = fractal(rng, size, beta=0.9, low=4)
    face = base * (tone + 0.17 * rough)[..., None] * (1 + hue)
    dx, dy = 0.5 - np.abs(along % 1 - 0.5), 0.5 - np.abs((y * ny) % 1 - 0.5)
    edge = np.minimum(dx * 3.2, dy)
    m = smoothstep(0.06, 0.14, edge + 0.012 * rough)[..., None]
    grey = mortar * (1 + 0.12 * fractal(rng, size, beta=0.6))[..., None]
    return np.asarray(face * m + grey * (1 - m), dtype=np.float32)


def tiles(
    rng: np.random.Generator,
    colour: Field,
    grout: Field,
    n: int = 8,
    marble: float = 0.5,
) -> Field:
    """Square ceramic tiles; 2.4 m per repeat, 30 cm tiles."""
    size = 1024
    y, x = _grid(size)
    ident = (y * n).astype(np.int32) * n + (x * n).astype(np.int32)
    tone = rng.normal(1, 0.05, n * n).astype(np.float32)[ident]
    cloud = fractal(rng, size, beta=1.5)
    vein = np.exp(-np.abs(fractal(rng, size, beta=1.4, high=120)) * 14)
    face = colour * (tone + 0.05 * cloud - marble * 0.22 * vein)[..., None]
    edge = 0.5 - np.maximum(np.abs((x * n) % 1 - 0.5), np.abs((y * n) % 1 - 0.5))
    m = smoothstep(0.008, 0.018, edge)[..., None]
    return np.asarray(face * m + grout * (1 - m), dtype=np.float32)


def carpet(rng: np.random.Generator, colour: Field, strength: float = 1.0) -> Field:
    """Cut pile; 2 m per repeat."""
    pile = fractal(rng, 1024, beta=0.25, low=60)
    wear = fractal(rng, 1024, beta=1.5, high=60)
    fleck = (fractal(rng, 1024, beta=0.1, low=100) > 2.0).astype(np.float32)
    v = 1 + strength * (0.16 * pile + 0.08 * wear)
    return np.asarray(
        np.maximum(colour * v[..., None] + 0.1 * strength * fleck[..., None], 0.01),
        dtype=np.float32,
    )


def fabric(
    rng: np.random.Generator,
    colour: Field,
    second: Field | None = None,
    threads: int = 96,
) -> Field:
    """Woven upholstery, 0.8 m per repeat; with ``second`` a check of two colours."""
    y, x = _grid(512)
    weave = np.sin(2 * np.pi * threads * x) * np.sin(2 * np.pi * threads * y)
    fold = fractal(rng, 512, beta=1.5, high=60)
    slub = fractal(rng, 512, beta=0.4, stretch=6, low=20) + fractal(rng, 512, beta=0.4, stretch=6, low=20).T
    v = 1 + 0.07 * weave + 0.07 * fold + 0.07 * slub
    base = np.broadcast_to(colour, (512, 512, 3))
    if second is not None:
        stripes = 0.5 * ((x * 8) % 1 < 0.5) + 0.5 * ((y * 8) % 1 < 0.5)
        base = colour * (1 - stripes[..., None]) + second * stripes[..., None]
    return np.asarray(base * v[..., None], dtype=np.float32)


def wallpaper(rng: np.random.Generator, ground: Field, figure: Field, style: int = 0) -> Field:
    """Wallpaper, 1.2 m per repeat. style: 0 damask, 1 stripes, 2 scattered leaves."""
    size = 1024
    y, x = _grid(size)
    if style == 0:
        n = 4
        row = np.floor(y * n)
        lx, ly = ((x * n + 0.5 * (row % 2)) % 1 - 0.5) * 2, ((y * n) % 1 - 0.5) * 2
        r, a = np.hypot(lx, ly * 0.8), np.arctan2(np.abs(lx), ly)
        petal = 0.45 + 0.22 * np.cos(5 * a) + 0.1 * np.cos(11 * a + 0.6)
        m = smoothstep(-0.03, 0.03, (petal - r).astype(np.float32))
        inner = smoothstep(-0.03, 0.03, (0.2 + 0.08 * np.cos(4 * a) - r).astype(np.float32))
        lattice = smoothstep(0.06, 0.0, np.abs(np.abs(lx) + np.abs(ly) - 0.97).astype(np.float32))
        m = np.maximum(m - inner * 0.8, lattice * 0.7)
    elif style == 1:
        s = (x * 10) % 1
        m = smoothstep(0.0, 0.02, s) * smoothstep(0.5, 0.48, s) + 0.7 * smoothstep(0.03, 0.0, np.abs(s - 0.75))
    else:
        m = np.zeros((size, size), np.float32)
        for _ in range(90):
            cy, cx = rng.integers(0, size, 2)
            angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(0.035, 0.08) * size
            r = int(length) + 2
            dy, dx = np.mgrid[-r : r + 1, -r : r + 1].astype(np.float32)
            u = (dx * np.cos(angle) + dy * np.sin(angle)) / length
            v = np.abs(dy * np.cos(angle) - dx * np.sin(angle)) / length
            blade = smoothstep(-0.04, 0.04, 0.42 * (1 - u * u) - v) * (0.6 + 0.4 * smoothstep(0.0, 0.05, v))
            window = np.ix_((cy + np.arange(-r, r + 1)) % size, (cx + np.arange(-r, r + 1)) % size)
            m[window] = np.maximum(m[window], blade)
    paper = 1 + 0.035 * fractal(rng, size, beta=0.5, low=30) + 0.04 * fractal(rng, size, beta=1.6, high=50)
    m = m[..., None]
    return np.asarray((ground * (1 - m) + figure * m) * paper[..., None], dtype=np.float32)


def rug(rng: np.random.Generator, colours: list[Field]) -> Field:
    """A whole patterned rug, one repeat: borders, medallion, scattered motifs, woven grain."""
    h, w = 512, 768
    y, x = _grid((h, w))
    ax, ay = np.abs(x - 0.5) * 2 * 1.5, np.abs(y - 0.5) * 2
    edge = np.minimum(1.5 - ax, 1 - ay)
    index = np.zeros((h, w), np.int32)
    a, r = np.arctan2(ay, ax), np.hypot(ax, ay)
    waves = np.sin(9 * ax + rng.uniform(0, 6)) * np.sin(9 * ay + rng.uniform(0, 6))
    index[waves > 0.55] = 1
    index[waves < -0.6] = 2
    star = 0.55 + 0.12 * np.cos(8 * a) + 0.05 * np.cos(20 * a)
    index[r < star] = 3
    index[r < star * 0.82] = 4
    dots = np.sin(28 * ax) * np.sin(28 * ay) > 0.35
    index[(r < star * 0.82) & dots] = 1
    index[r < star * 0.35] = 2
    index[r < star * 0.2] = 0
    band = edge < 0.26
    index[band] = 3
    t = np.where(1.5 - ax < 1 - ay, ay, ax)
    diamond = np.abs((t * 7) % 1 - 0.5) * 0.28 + np.abs(edge - 0.14)
    index[band & (diamond < 0.085)] = 1
    index[band & (diamond < 0.045)] = 4
    index[(edge < 0.26) & (edge > 0.235)] = 2
    index[edge < 0.035] = 1
    rgb = np.stack(colours)[index]
    grain = 1 + 0.09 * fractal(rng, (h, w), beta=0.2, low=40) + 0.08 * fractal(rng, (h, w), beta=1.4, high=60)
    out = rgb * grain[..., None]
    return np.asarray(_resize(out, 1024, 1024), dtype=np.float32)


def stone(rng: np.random.Generator, colour: Field) -> Field:
    """Speckled worktop; 1 m per repeat."""
    _, _, ident = cells(rng, 512, 1500)
    tone = rng.normal(1, 0.16, 1500).astype(np.float32)[ident]
    return np.asarray(
        colour * (tone + 0.06 * fractal(rng, 512, beta=1.2))[..., None],
        dtype=np.float32,
    )


def brushed(rng: np.random.Generator, colour: Field) -> Field:
    """Brushed metal or plain lacquer; 0.5 m per repeat."""
    v = 1 + 0.05 * fractal(rng, 256, beta=0.5, stretch=15) + 0.03 * fractal(rng, 256, beta=1.5)
    return np.asarray(colour * v[..., None], dtype=np.float32)


def leaf(rng: np.random.Generator) -> Field:
    """One leaf along x, filling the quad: midrib, veins, mottling."""
    y, x = _grid(128)
    rib = np.exp(-np.abs(y - 0.5) * 60)
    veins = np.exp(-np.abs(((x - np.abs(y - 0.5) * 0.7) * 9) % 1 - 0.5) * 14) * 0.35
    v = 0.55 + 0.16 * fractal(rng, 128, beta=1.2) + 0.5 * (rib + veins)
    return ramp(v * 0.7, linear(20, 52, 22), linear(58, 112, 44), linear(150, 180, 96))


def macro(rng: np.random.Generator) -> Field:
    """Slow variation of the albedo of large surfaces, of mean 0.5 in every channel; 5 m per repeat."""
    v = 0.5 + 0.13 * fractal(rng, 256, beta=1.7, high=80)
    return np.asarray(np.repeat(np.clip(v, 0.05, 0.95)[..., None], 3, axis=-1), dtype=np.float32)


def _resize(image: Field, h: int, w: int) -> Field:
    import cv2

    return np.asarray(cv2.resize(image, (w, h), interpolation=cv2.INTER_CUBIC), dtype=np.float32)

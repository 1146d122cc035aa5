"""Textures that are pictures: paintings, posters, book spines, screens, the view from the window.

Each function returns linear RGB (H, W, 3).
"""

from __future__ import annotations

import numpy as np

from panobench.rooms.noise import (
    Field,
    cells,
    fractal,
    hsv,
    linear,
    ramp,
    smoothstep,
)

SIZE = 256
# Colours of book covers and of their lettering, sRGB.
_CLOTH = [
    (112, 30, 28), (36, 52, 92), (44, 78, 56), (196, 182, 150), (40, 38, 40), (150, 110, 44), (92, 60, 40),
    (60, 96, 104), (170, 84, 40), (206, 204, 196), (84, 40, 70), (120, 124, 120), (176, 48, 44), (70, 92, 140),
]  # fmt: skip
_FOIL = [(222, 200, 140), (236, 232, 220), (30, 28, 30), (190, 60, 50), (240, 214, 90)]


def _canvas(size: int = SIZE) -> tuple[Field, Field]:
    g = (np.arange(size, dtype=np.float32) + 0.5) / size
    y, x = np.meshgrid(g, g, indexing="ij")
    return y, x


def landscape(rng: np.random.Generator) -> Field:
    """A landscape: sky, ridges, a meadow."""
    y, _ = _canvas()
    dusk = rng.uniform() < 0.4
    top, bottom = (linear(40, 50, 95), linear(240, 150, 90)) if dusk else (linear(70, 120, 190), linear(215, 225, 235))
    out = ramp(y * 1.6, top, bottom)
    cloud = (
        smoothstep(0.3, 1.8, fractal(rng, SIZE, beta=1.5, stretch=2.0))[..., None] * smoothstep(0.7, 0.2, y)[..., None]
    )
    out = out * (1 - 0.6 * cloud) + 0.6 * cloud * linear(250, 240, 235)
    for k in range(4):
        level = 0.35 + 0.11 * k
        ridge = level - (0.13 - 0.02 * k) * _profile(rng, 1.2 + 0.1 * k)
        m = smoothstep(-0.006, 0.006, y - ridge[None])[..., None]
        tone = linear(90, 100, 130) * (1 - k / 3) + linear(30, 62, 28) * (k / 3)
        shade = tone * (1 + 0.3 * fractal(rng, SIZE, beta=1.0))[..., None]
        out = out * (1 - m) + shade * m
    meadow = smoothstep(0.8, 0.84, y)[..., None]
    ground = linear(110, 130, 60) * (1 + 0.3 * fractal(rng, SIZE, beta=0.8, stretch=3))[..., None]
    return np.clip(out * (1 - meadow) + ground * meadow, 0.01, 0.95).astype(np.float32)


def _profile(rng: np.random.Generator, beta: float) -> Field:
    line = fractal(rng, (1, SIZE), beta=beta)[0]
    return np.asarray((line - line.min()) / (np.ptp(line) + 1e-6), dtype=np.float32)


def abstract(rng: np.random.Generator) -> Field:
    """An abstract painting: Voronoi patches and strokes in a small palette."""
    _, _, ident = cells(rng, SIZE, int(rng.integers(14, 60)))
    hue = rng.uniform(0, 1)
    palette = np.stack(
        [
            hsv(
                (hue + rng.normal(0, 0.12)) % 1,
                rng.uniform(0.2, 0.85),
                rng.uniform(0.25, 0.95),
            )
            for _ in range(7)
        ]
    )
    out = palette[ident % 7]
    y, x = _canvas()
    waver = fractal(rng, SIZE, beta=1.6)
    for _ in range(5):
        a, c, wdt = (
            rng.uniform(0, np.pi),
            rng.uniform(0.2, 0.8),
            rng.uniform(0.008, 0.03),
        )
        d = np.abs((x - 0.5) * np.cos(a) + (y - 0.5) * np.sin(a) + 0.5 - c + 0.02 * waver)
        m = smoothstep(wdt + 0.006, wdt, d)[..., None]
        out = out * (1 - m) + palette[int(rng.integers(7))] * 0.5 * m
    return np.clip(out * (1 + 0.1 * fractal(rng, SIZE, beta=0.7))[..., None], 0.01, 0.95).astype(np.float32)


def portrait(rng: np.random.Generator) -> Field:
    """A still life: a few lit round shapes before a dark ground."""
    y, x = _canvas()
    out = ramp(
        0.3 + 0.5 * y + 0.1 * fractal(rng, SIZE, beta=1.4),
        linear(40, 30, 26),
        linear(120, 90, 60),
    )
    for _ in range(6):
        cx, cy, r = (
            rng.uniform(0.2, 0.8),
            rng.uniform(0.45, 0.8),
            rng.uniform(0.08, 0.2),
        )
        d = np.hypot(x - cx, (y - cy) * rng.uniform(0.8, 1.2)) / r
        m = smoothstep(1.02, 0.98, d)[..., None]
        lit = np.clip(1.1 - np.hypot(x - cx + 0.4 * r, y - cy + 0.4 * r) / r / 1.6, 0.08, 1)[..., None]
        out = out * (1 - m) + hsv(rng.uniform(0, 0.16), rng.uniform(0.5, 0.9), 0.8) * lit * m
    return np.clip(out * (1 + 0.08 * fractal(rng, SIZE, beta=0.6))[..., None], 0.01, 0.95).astype(np.float32)


def poster(rng: np.random.Generator) -> Field:
    """A printed sheet: a heading, lines of text, a chart."""
    y, x = _canvas()
    out = np.ones((SIZE, SIZE, 3), np.float32) * linear(238, 234, 224)
    out *= (1 + 0.02 * fractal(rng, SIZE, beta=1.2))[..., None]
    ink = linear(35, 35, 40)
    words = rng.uniform(0, 1, (40, 64)) < 0.8
    row, col = (y * 40).astype(np.int32), (x * 64).astype(np.int32)
    text = (
        words[row, col] & ((y * 40) % 1 > 0.35) & (x > 0.1) & (x < 0.9 - 0.1 * (row % 3 == 0)) & (row > 8) & (row < 24)
    )
    out[text] = ink
    head = (y > 0.07) & (y < 0.15) & (x > 0.15) & (x < 0.85) & (((x * 23) % 1) > 0.25)
    out[head] = hsv(rng.uniform(), 0.8, 0.5)
    bars = rng.uniform(0.05, 0.3, 12)
    bar = (x * 14).astype(np.int32) - 1
    inside = (bar >= 0) & (bar < 12) & ((x * 14) % 1 > 0.3)
    height = bars[np.clip(bar, 0, 11)]
    out[inside & (y > 0.95 - height) & (y < 0.95)] = hsv(rng.uniform(), 0.7, 0.6)
    return out


def spines(rng: np.random.Generator) -> Field:
    """Eight upright book spines side by side, each an eighth of the width."""
    h, w = 256, 256
    out = np.zeros((h, w, 3), np.float32)
    y = ((np.arange(h) + 0.5) / h)[:, None]
    for k in range(8):
        base = linear(*_CLOTH[int(rng.integers(len(_CLOTH)))]) * rng.uniform(0.75, 1.3)
        second = linear(*_FOIL[int(rng.integers(len(_FOIL)))])
        x = np.linspace(-1, 1, w // 8)[None]
        col = np.broadcast_to(base, (h, w // 8, 3)) * (1 - 0.45 * x**4)[..., None]
        a, b = rng.uniform(0.12, 0.3), rng.uniform(0.5, 0.75)
        letters = rng.uniform(0, 1, (44, 5)) < 0.6
        lit = letters[(y * 43).astype(int), np.clip(((x + 1) * 2.4).astype(int), 0, 4)]
        title = (y > a) & (y < b) & (np.abs(x) < 0.55) & lit
        bands = (np.abs(y - a + 0.05) < 0.01) | (np.abs(y - b - 0.05) < 0.01) | (np.abs(y - 0.92) < 0.008)
        m = (title | np.broadcast_to(bands, title.shape))[..., None]
        out[:, k * (w // 8) : (k + 1) * (w // 8)] = np.where(m, second, col)
    return np.clip(out * (1 + 0.07 * fractal(rng, (h, w), beta=0.6))[..., None], 0.01, 0.95).astype(np.float32)


def screen(rng: np.random.Generator) -> Field:
    """A desktop with windows, as emitted light."""
    y, x = _canvas()
    out = ramp(0.4 * x + 0.6 * y, linear(20, 40, 90), linear(70, 30, 90), linear(20, 90, 110))
    for k in range(3):
        x0, y0 = rng.uniform(0.03, 0.5, 2)
        w, h = rng.uniform(0.3, 0.46), rng.uniform(0.3, 0.46)
        m = (x > x0) & (x < x0 + w) & (y > y0) & (y < y0 + h)
        out[m] = linear(235, 236, 238) if k % 2 else linear(32, 34, 40)
        row = ((y - y0) * 34).astype(np.int32)
        words = rng.uniform(0, 1, (40, 48)) < 0.65
        t = (
            m
            & words[np.clip(row, 0, 39), (x * 47).astype(np.int32)]
            & (((y - y0) * 34) % 1 > 0.4)
            & (row > 1)
            & (x < x0 + w * 0.9)
        )
        out[t] = linear(60, 70, 90) if k % 2 else hsv(rng.uniform(), 0.4, 0.8)
        out[m & (y < y0 + 0.03)] = linear(90, 120, 170)
    return out.astype(np.float32)


def outdoors(rng: np.random.Generator) -> Field:
    """The view from a window, as emitted light in 0..1: sky with clouds, trees, houses, grass."""
    size = 512
    y, x = _canvas(size)
    out = ramp(y * 1.7, linear(120, 170, 235), linear(205, 225, 245), linear(235, 240, 245))
    cloud = smoothstep(0.0, 1.6, fractal(rng, size, beta=1.4, stretch=2.0))[..., None]
    out = out * (1 - 0.7 * cloud) + 0.7 * cloud
    for _ in range(5):
        x0, w, top = (
            rng.uniform(0, 0.95),
            rng.uniform(0.06, 0.16),
            rng.uniform(0.36, 0.55),
        )
        m = (x > x0) & (x < x0 + w) & (y > top)
        wall = hsv(rng.uniform(0.02, 0.12), rng.uniform(0.1, 0.4), rng.uniform(0.4, 0.8))
        pane = (((x - x0) / w * 4) % 1 > 0.45) & (((y - top) * 22) % 1 > 0.5)
        out[m] = wall
        out[m & pane] = linear(70, 85, 105)
    outline, inner = fractal(rng, size, beta=0.9, low=6), fractal(rng, size, beta=0.5, low=12)
    for _ in range(18):
        cx, cy, r = rng.uniform(0, 1), rng.uniform(0.58, 0.76), rng.uniform(0.05, 0.13)
        roll = tuple(int(k) for k in rng.integers(0, size, 2))
        d = np.hypot((x - cx + 0.5) % 1 - 0.5, (y - cy) * 0.85) / r + 0.28 * np.roll(outline, roll, (0, 1))
        m = smoothstep(1.0, 0.9, d)[..., None]
        light = np.clip(0.75 - 0.45 * (y - cy) / r + 0.25 * np.roll(inner, roll, (0, 1)), 0.15, 1.4)[..., None]
        out = out * (1 - m) + hsv(rng.uniform(0.22, 0.33), 0.65, rng.uniform(0.25, 0.5)) * light * m
    grass = smoothstep(0.74, 0.77, y)[..., None]
    lawn = linear(98, 132, 62) * (1 + 0.25 * fractal(rng, size, beta=0.6, stretch=2))[..., None]
    return np.clip(out * (1 - grass) + lawn * grass, 0.01, 1.0).astype(np.float32)

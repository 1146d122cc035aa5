"""Tileable random fields for textures, and colour conversions. Natural surfaces have power spectra near 1 / f^2."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Field = NDArray[Any]  # float32, (H, W) or (H, W, 3)


def fractal(
    rng: np.random.Generator,
    size: int | tuple[int, int] = 512,
    *,
    beta: float = 1.0,
    stretch: float = 1.0,
    low: float = 1.0,
    high: float = 1e9,
) -> Field:
    """Gaussian field (H, W) of mean 0 and deviation 1, with amplitude 1 / f^beta.

    low, high: band limits in cycles per image. stretch: above 1 the field is drawn out along x, as wood fibres are.
    """
    h, w = (size, size) if isinstance(size, int) else size
    fy = np.fft.fftfreq(h)[:, None] * h
    fx = np.fft.rfftfreq(w)[None] * w
    f = np.hypot(fx * stretch, fy).astype(np.float32)
    f[0, 0] = 1.0
    amplitude = f**-beta * np.exp(-((f / high) ** 2)) * (1 - np.exp(-((f / low) ** 2)))
    amplitude[0, 0] = 0.0
    phase = np.fft.rfft2(rng.standard_normal((h, w), dtype=np.float32))
    out = np.fft.irfft2(phase * amplitude, s=(h, w)).astype(np.float32)
    return out / max(float(out.std()), 1e-9)


def cells(rng: np.random.Generator, size: int, count: int) -> tuple[Field, Field, NDArray[np.int32]]:
    """Tileable Voronoi cells of ``count`` points: distances to the nearest and second point, and the nearest's index.

    All are (size, size); distances in units of the image.
    """
    from scipy.spatial import cKDTree

    p = rng.uniform(0, 1, (count, 2))
    tree = cKDTree(p, boxsize=1.0)
    g = (np.arange(size) + 0.5) / size
    q = np.stack(np.meshgrid(g, g, indexing="ij"), axis=-1).reshape(-1, 2)
    d, i = tree.query(q, k=2)
    d = d.reshape(size, size, 2).astype(np.float32)
    return d[..., 0], d[..., 1], i[:, 0].reshape(size, size).astype(np.int32)


def smoothstep(a: float, b: float, x: Field) -> Field:
    """0 below a, 1 above b, and a cubic between."""
    t = np.clip((x - a) / (b - a), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def linear(r: float, g: float, b: float) -> Field:
    """Linear RGB (3,) of an sRGB colour in 0..255 (IEC 61966-2-1)."""
    c = np.asarray([r, g, b], dtype=np.float32) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def ramp(x: Field, *colours: Field) -> Field:
    """Colours (H, W, 3) of a field (H, W) in 0..1, interpolated between evenly spaced ones."""
    n = len(colours) - 1
    t = np.clip(x, 0.0, 1.0) * n
    i = np.minimum(t.astype(np.int32), n - 1)
    table = np.stack(colours)
    f = (t - i)[..., None]
    return np.asarray(table[i] * (1 - f) + table[i + 1] * f, dtype=np.float32)


def hsv(h: float, s: float, v: float) -> Field:
    """Linear RGB (3,) of hue, saturation and value (sRGB), each in 0..1."""
    k = (np.array([5.0, 3.0, 1.0]) + h * 6) % 6
    rgb = v - v * s * np.clip(np.minimum(k, 4 - k), 0, 1)
    return linear(*(255 * rgb))

"""The textures by name, and their packing into one array with mip maps for the shader.

A name is "pattern" or "pattern:r,g,b" (sRGB 0..255, where the pattern takes a colour), with "#k" for variants.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.rooms import patterns, pictures
from panobench.rooms.noise import Field, linear

_WOODS = {
    "oak": (linear(120, 78, 40), linear(196, 148, 92)),
    "walnut": (linear(52, 30, 18), linear(122, 78, 48)),
    "pine": (linear(172, 122, 66), linear(226, 186, 128)),
    "cherry": (linear(96, 40, 22), linear(166, 84, 50)),
    "ash": (linear(150, 132, 108), linear(206, 192, 168)),
    "ebony": (linear(24, 20, 18), linear(58, 48, 42)),
}

_RUGS = {
    "rug-red": [
        linear(150, 28, 30),
        linear(226, 208, 160),
        linear(36, 92, 82),
        linear(28, 34, 86),
        linear(190, 120, 50),
    ],
    "rug-blue": [
        linear(40, 62, 110),
        linear(220, 214, 196),
        linear(150, 60, 50),
        linear(24, 30, 56),
        linear(120, 150, 170),
    ],
    "rug-sand": [
        linear(186, 162, 124),
        linear(96, 72, 52),
        linear(214, 200, 172),
        linear(120, 60, 42),
        linear(70, 84, 74),
    ],
    "rug-grey": [
        linear(122, 122, 124),
        linear(206, 204, 200),
        linear(64, 66, 70),
        linear(168, 160, 150),
        linear(90, 92, 96),
    ],
}

Coloured = Callable[[np.random.Generator, Field], Field]
_COLOURED: dict[str, Coloured] = {
    "plaster": patterns.plaster,
    "smooth": lambda r, c: patterns.plaster(r, c, 0.3),
    "carpet": patterns.carpet,
    "fabric": patterns.fabric,
    "check": lambda r, c: patterns.fabric(r, c, c * 0.35 + 0.3),
    "tiles": lambda r, c: patterns.tiles(r, c, linear(150, 146, 140)),
    "stone": patterns.stone,
    "metal": patterns.brushed,
    "brick": lambda r, c: patterns.brick(r, c, linear(176, 170, 160)),
    "damask": lambda r, c: patterns.wallpaper(r, c, c * 0.45 + 0.03, 0),
    "stripes": lambda r, c: patterns.wallpaper(r, c, np.minimum(c * 1.5, 0.9), 1),
    "leaves": lambda r, c: patterns.wallpaper(r, c, c * 0.4, 2),
}

_PLAIN: dict[str, Callable[[np.random.Generator], Field]] = {
    "landscape": pictures.landscape,
    "abstract": pictures.abstract,
    "portrait": pictures.portrait,
    "poster": pictures.poster,
    "spines": pictures.spines,
    "screen": pictures.screen,
    "outdoors": pictures.outdoors,
    "leaf": patterns.leaf,
    "macro": patterns.macro,
}


def make_texture(name: str, seed: int) -> Field:
    """Linear RGB (H, W, 3) float32 of a texture; its sides are powers of two. Raises KeyError for an unknown name."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    body = name.partition("#")[0]
    pattern, _, argument = body.partition(":")
    if pattern in _COLOURED:
        return _COLOURED[pattern](rng, linear(*(float(v) for v in argument.split(","))))
    if pattern in _RUGS:
        return patterns.rug(rng, _RUGS[pattern])
    wood, _, kind = pattern.partition("-")
    if wood in _WOODS:
        if kind == "floor":
            return patterns.planks(rng, *_WOODS[wood])
        if kind == "parquet":
            return patterns.parquet(rng, *_WOODS[wood])
        return patterns.wood(rng, *_WOODS[wood])
    return _PLAIN[pattern](rng)


@dataclass(frozen=True)
class TextureAtlas:
    """All textures, each with its mip maps, as uint8 RGB of gamma 2: value = 255 sqrt(linear).

    texels (T, 3); table (K, 3) int64: first texel, log2 width, log2 height; mean (K, 3): mean linear colour.
    """

    texels: NDArray[np.uint8]
    table: NDArray[np.int64]
    mean: NDArray[np.float32]


def pack(images: list[Field]) -> TextureAtlas:
    """Pack linear images with their mip maps, made by a box filter in linear light."""
    chunks, rows, means, at = [], [], [], 0
    for image in images:
        h, w = image.shape[:2]
        rows.append((at, int(np.log2(w)), int(np.log2(h))))
        means.append(image.reshape(-1, 3).mean(axis=0))
        level = np.clip(image, 0.0, 1.0)
        while True:
            code = np.round(255 * np.sqrt(level)).astype(np.uint8).reshape(-1, 3)
            chunks.append(code)
            at += len(code)
            h, w = level.shape[:2]
            if h == 1 and w == 1:
                break
            if w > 1:
                level = 0.5 * (level[:, 0::2] + level[:, 1::2])
            if h > 1:
                level = 0.5 * (level[0::2] + level[1::2])
    return TextureAtlas(
        np.concatenate(chunks),
        np.asarray(rows, dtype=np.int64),
        np.asarray(means, dtype=np.float32),
    )

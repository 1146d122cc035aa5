"""Scale pictures for the page and encode them as WebP data URIs, within a budget of bytes."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.images import decode_stored
from panobench.errors import DatasetError

#: Bytes of base64 text all pictures together may take, unless the page's limit leaves less.
BUDGET = 6_500_000
#: (frames per sequence, width in px, WebP quality), from generous to frugal.
LADDER = (
    (10, 1024, 84),
    (8, 1024, 80),
    (6, 1024, 78),
    (6, 768, 78),
    (4, 768, 76),
    (4, 640, 76),
    (3, 512, 76),
    (2, 512, 74),
    (1, 512, 72),
    (1, 384, 70),
    (1, 256, 64),
)


@dataclass(frozen=True)
class Plan:
    """How many frames per run are shown, and how they are encoded."""

    frames: int
    width: int
    quality: int


@dataclass(frozen=True)
class Picture:
    """A picture ready for the page."""

    uri: str
    width: int
    height: int


SMALLEST = Plan(*LADDER[-1])


def plan(sets: Sequence[Sequence[Path]], budget: int = BUDGET) -> Plan:
    """The most generous plan whose estimated size fits; the last one if none does.

    ``sets`` holds, per frame that could be shown at full generosity, the paths of its pictures; sets
    beyond a plan's frame count are dropped by the caller, so each set counts pictures of one run.
    """
    samples = [paths[len(paths) // 2] for paths in sets if paths][:: max(1, len(sets) // 4)][:4]
    for frames, width, quality in LADDER:
        sizes = [len(p.uri) for s in samples if (p := encode_file(s, width, quality)) is not None]
        if not sizes:
            break
        count = sum(min(len(paths), 2 * frames) for paths in sets)
        if count * sum(sizes) / len(sizes) <= budget:
            return Plan(frames, width, quality)
    return SMALLEST


def encode_file(path: Path, width: int, quality: int = 80) -> Picture | None:
    """A picture file scaled down to ``width`` (never up) as a data URI; None when it cannot be read."""
    image = read(path)
    return None if image is None else encode(image, width, quality)


def read(path: Path) -> NDArray[np.uint8] | None:
    """A picture as 8-bit BGR or grey (H, W[, 3]); 16-bit ones are mapped to colours as depth. None if unreadable."""
    try:
        image = decode_stored(path.read_bytes(), path)
    except (OSError, DatasetError):
        return None
    if image.dtype == np.uint16:
        return colour_depth(image.astype(np.float32))
    if image.ndim == 3 and image.shape[2] == 4:
        image = image[..., :3]
    return np.ascontiguousarray(image.astype(np.uint8))


def colour_depth(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W) depth, 0 or NaN unknown -> BGR picture: near bright, far dark, by inverse depth; unknown grey."""
    import cv2

    known = np.isfinite(depth) & (depth > 0)
    out = np.full((*depth.shape, 3), 128, dtype=np.uint8)
    if known.any():
        inverse = 1.0 / np.where(known, depth, 1.0)
        low, high = np.percentile(inverse[known], [2, 98])
        level = np.clip((inverse - low) / max(float(high - low), 1e-12), 0, 1)
        picture = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
        out[known] = picture[known]
    return out


def encode(image: NDArray[np.uint8], width: int, quality: int = 80) -> Picture:
    """An 8-bit picture scaled down by area and encoded as a WebP data URI."""
    import cv2

    h, w = image.shape[:2]
    if w > width:
        image = cv2.resize(image, (width, max(1, round(h * width / w))), interpolation=cv2.INTER_AREA).astype(np.uint8)
    _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])
    text = base64.b64encode(data.tobytes()).decode("ascii")
    return Picture(f"data:image/webp;base64,{text}", image.shape[1], image.shape[0])


def spread(count: int, keep: int) -> list[int]:
    """``keep`` indices out of ``count``, evenly spread, first and last among them (the middle one for keep 1)."""
    if count <= keep:
        return list(range(count))
    if keep == 1:
        return [count // 2]
    return sorted({round(i * (count - 1) / (keep - 1)) for i in range(keep)})

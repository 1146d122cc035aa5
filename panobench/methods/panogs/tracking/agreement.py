"""Agreement: the share of a frame that a render explains, by zero-mean normalised cross-correlation of blocks.

The correlation of a block does not depend on gain and offset, and an occluder spoils only the blocks that it covers. A
mean residual has neither property.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.pyramid import F32, luma_of_planes
from panobench.splat.render import Render

#: Side of a block, in pixels of the width on which blocks are compared.
BLOCK = 8
#: Standard deviation (of 1) below which a block of the frame has nothing to compare.
TEXTURE_MIN = 0.015
#: Opacity from which the map claims to know a pixel, and the share of a block it must know.
KNOWN, KNOWN_SHARE = 0.5, 0.7
#: Share of the view's weight that must be known to the map for a pose to mean anything.
SEEN_MIN = 0.05


@dataclass(frozen=True)
class Detail:
    """width: on which blocks are compared, in pixels. alike: correlation from which a block agrees."""

    width: int
    alike: float

    def for_camera(self, camera: Camera) -> Detail:
        """The same angles, where ``width`` is meant to go all the way round: a part of it for a narrow view."""
        pixel = float(np.sqrt(camera.solid_angle().max()))
        return replace(self, width=round(self.width * camera.width * pixel / (2 * np.pi)))


#: Is the camera still where it is believed to be? A blurred or dark frame should not fail this.
COARSE = Detail(128, 0.6)
#: Is it there at all? All the way round. Repetitive buildings look alike from afar: on a walk past prison cells, wrong
#: places had up to 94% of the coarse blocks right, and 56% of these; right places had at least 76%.
FINE = Detail(256, 0.75)


def agreement(frame: list[F32], render: Render, weights: F32, detail: Detail = COARSE) -> float:
    """Share (0..1) of the textured blocks known to the map that agree; 1 where nothing has texture, 0 where hardly
    anything is known.

    frame: luma pyramid, level 0 (H, W), NaN where invalid; weights (H, W): of the loss.
    """
    level = 0
    while level + 1 < len(frame) and frame[level].shape[1] > detail.width:
        level += 1
    shape = frame[level].shape
    size = (shape[1], shape[0])
    seen = cv2.resize(luma_of_planes(render.planes), size, interpolation=cv2.INTER_AREA)
    opacity = cv2.resize(render.opacity, size, interpolation=cv2.INTER_AREA)
    w = np.asarray(cv2.resize(weights, size, interpolation=cv2.INTER_AREA), np.float32)
    valid = np.isfinite(frame[level]) & (w > 0)
    known = valid & (opacity > KNOWN)
    total = float(w[valid].sum())
    if total <= 0 or float(w[known].sum()) < SEEN_MIN * total:
        return 0.0
    return share_alike(frame[level], np.asarray(seen, np.float32), known, w, detail.alike)


def share_alike(frame: F32, seen: F32, known: NDArray[np.bool_], weights: F32, alike: float) -> float:
    """Share (0..1) of the textured blocks of ``frame`` that correlate with ``seen`` by more than ``alike``.

    All (h, w); known: where both have a value. 1 where nothing has texture.
    """
    share, weight, correlation, texture = _blocks(frame, seen, known, weights)
    usable = (share >= KNOWN_SHARE) & (texture > TEXTURE_MIN)
    counted = float(weight[usable].sum())
    return float(weight[usable & (correlation > alike)].sum()) / counted if counted > 0 else 1.0


def _blocks(frame: F32, seen: F32, known: NDArray[np.bool_], weights: F32) -> tuple[F32, F32, F32, F32]:
    """Per block: share of pixels known, weight, correlation of frame and render, deviation of the frame."""
    n = known.astype(np.float32)
    a, b = np.where(known, frame, 0).astype(np.float32), np.where(known, seen, 0).astype(np.float32)
    count = np.maximum(_sums(n), 1)
    ma, mb = _sums(a) / count, _sums(b) / count
    va, vb = _sums(a * a) / count - ma * ma, _sums(b * b) / count - mb * mb
    both = _sums(a * b) / count - ma * mb
    correlation = both / np.sqrt(np.maximum(va * vb, 1e-12))
    deviation = np.sqrt(np.maximum(va, 0))
    return _sums(n) / np.float32(BLOCK**2), _sums(weights * n), np.asarray(correlation), np.asarray(deviation)


def _sums(x: F32) -> F32:
    """Sums over whole blocks; what is left over at the right and below does not count."""
    h, w = x.shape[0] // BLOCK, x.shape[1] // BLOCK
    return np.asarray(x[: h * BLOCK, : w * BLOCK].reshape(h, BLOCK, w, BLOCK).sum(axis=(1, 3)))

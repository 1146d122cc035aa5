"""The panoramic photometric loss and its gradient.

L_pano = sum_u w(u) |exp(gain) I_render(u) + offset - I(u)| / (3 sum w) with w = cos(latitude) on valid pixels, the
sphere-consistent weights of the PanoGS-SLAM paper. "uniform" and "gaussian" weights serve its ablation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import lonlat_from_directions
from panobench.kernels.jit import PARALLEL, njit, prange
from panobench.kernels.weighting import Weighting, latitude_weight
from panobench.splat.gaussians import F32


def pixel_weights(camera: Camera, weighting: Weighting = "cosine") -> F32:
    """(H, W) weights that sum to 1; 0 on invalid pixels. ``weighting`` is for panoramas: other cameras are uniform."""
    weights = camera.valid_mask().astype(np.float64)
    if camera.kind == "erp" and weighting != "uniform":
        _, latitude = lonlat_from_directions(camera.rays())
        weights *= latitude_weight(latitude, weighting)
    return np.asarray(weights / max(weights.sum(), 1e-12), dtype=np.float32)


@njit(**PARALLEL)
def _robust_l1(planes, image, weights, gain, offset, huber, gradient, sums):  # type: ignore[no-untyped-def]
    """Huber's loss without branches: with t = r / huber cut at +-1, r costs t r - huber t^2 / 2, and its slope is t.

    Shapes as in ``photometric_loss``; sums (H, 3) receives each row's loss and gradient by gain and offset.
    """
    h, w = weights.shape
    scale, g, o, huber = np.float32(1 / 255), np.float32(np.exp(gain)), np.float32(offset), np.float32(huber)
    one, steep = np.float32(1), np.float32(1) / max(huber, np.float32(1e-30))
    for y in prange(h):
        s, dg, do = np.float32(0), np.float32(0), np.float32(0)
        for x in range(w):
            k = weights[y, x] * np.float32(1 / 3)
            c0, c1, c2 = g * planes[0, y, x], g * planes[1, y, x], g * planes[2, y, x]
            r0 = c0 + o - scale * np.float32(image[y, x, 0])
            r1 = c1 + o - scale * np.float32(image[y, x, 1])
            r2 = c2 + o - scale * np.float32(image[y, x, 2])
            t0 = min(max(r0 * steep, -one), one)
            t1 = min(max(r1 * steep, -one), one)
            t2 = min(max(r2 * steep, -one), one)
            d0, d1, d2 = k * t0, k * t1, k * t2
            s += d0 * r0 + d1 * r1 + d2 * r2 - np.float32(0.5) * huber * (d0 * t0 + d1 * t1 + d2 * t2)
            dg += d0 * c0 + d1 * c1 + d2 * c2
            do += d0 + d1 + d2
            gradient[0, y, x], gradient[1, y, x], gradient[2, y, x] = d0 * g, d1 * g, d2 * g
        sums[y, 0], sums[y, 1], sums[y, 2] = s, dg, do


def photometric_loss(
    planes: F32,
    image: NDArray[np.uint8],
    weights: F32,
    gain: float = 0.0,
    offset: float = 0.0,
    huber: float = 0.0,
) -> tuple[float, F32, tuple[float, float]]:
    """Loss, dL/dplanes (3, H, W) and dL/d(gain, offset).

    planes (3, H, W): rendered colour, of 1. image (H, W, 3): RGB. weights (H, W): see ``pixel_weights``. gain, offset:
    image = exp(gain) render + offset. huber: residual, of 1, below which the cost is quadratic; 0 gives plain L1.
    """
    gradient = np.empty_like(planes)
    sums = np.empty((planes.shape[1], 3))
    _robust_l1(planes, image, weights, gain, offset, huber, gradient, sums)
    loss, d_gain, d_offset = sums.sum(axis=0)
    return float(loss), gradient, (float(d_gain), float(d_offset))


@njit(**PARALLEL)
def colour_error(planes, image):  # type: ignore[no-untyped-def]
    """(H, W) float32: mean over the colours of |render - image|, of 1, for planes (3, H, W) and an image (H, W, 3)."""
    h, w = image.shape[0], image.shape[1]
    out = np.empty((h, w), np.float32)
    scale = np.float32(1 / 255)
    for y in prange(h):
        for x in range(w):
            total = np.float32(0)
            for c in range(3):
                total += abs(planes[c, y, x] - scale * image[y, x, c])
            out[y, x] = total * np.float32(1 / 3)
    return out

"""PSNR, WS-PSNR and SSIM between two images with values in 0..1; definitions in docs/protocol.md.

SSIM: Wang et al., "Image quality assessment: from error visibility to structural similarity" (2004).
WS-PSNR: Sun, Lu, Yu, "Weighted-to-spherically-uniform quality evaluation for omnidirectional video" (2017).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
#: PSNR of equal images, which would be infinite; eight-bit rounding alone limits it to 59 dB.
MAX_PSNR_DB = 100.0
_RADIUS, _SIGMA = 5, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def psnr(a: Image, b: Image, weights: NDArray[np.floating] | NDArray[np.bool_] | None = None) -> float | None:
    """-10 log10 of the mean squared error of (H, W, 3), weighted per pixel (H, W); None if all weights are 0."""
    error = np.square(np.asarray(a, np.float64) - np.asarray(b, np.float64)).mean(axis=-1)
    w = np.ones(error.shape) if weights is None else np.asarray(weights, np.float64)
    total = w.sum()
    if total <= 0:
        return None
    mse = float((error * w).sum() / total)
    return min(MAX_PSNR_DB, -10.0 * float(np.log10(max(mse, 1e-12))))


def ssim(a: Image, b: Image, valid: NDArray[np.bool_] | None = None) -> float | None:
    """Mean structural similarity of (H, W, 3): 11x11 Gaussian window of sigma 1.5, per channel.

    Only windows inside the image and wholly on ``valid`` (H, W) pixels count; None if there are none.
    """
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    inside = np.zeros(x.shape[:2], bool)
    inside[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS] = True
    if valid is not None:
        window = np.ones((2 * _RADIUS + 1,) * 2, np.uint8)
        inside &= cv2.erode(valid.astype(np.uint8), window).astype(bool)
        x, y = np.where(valid[..., None], x, 0.0), np.where(valid[..., None], y, 0.0)
    if not inside.any():
        return None
    mx, my = _blur(x), _blur(y)
    vx, vy, cov = _blur(x * x) - mx * mx, _blur(y * y) - my * my, _blur(x * y) - mx * my
    index = ((2 * mx * my + _C1) * (2 * cov + _C2)) / ((mx * mx + my * my + _C1) * (vx + vy + _C2))
    return float(index[inside].mean())


def _blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    size = 2 * _RADIUS + 1
    return np.asarray(cv2.GaussianBlur(image, (size, size), _SIGMA, borderType=cv2.BORDER_REFLECT_101))

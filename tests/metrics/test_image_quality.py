"""PSNR, WS-PSNR and SSIM against direct evaluation of their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.metrics.image_quality import MAX_PSNR_DB, psnr, ssim


def images(h: int = 24, w: int = 32, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    a = rng.random((h, w, 3)).astype(np.float32)
    return a, np.clip(a + noise * rng.standard_normal(a.shape), 0, 1).astype(np.float32)


def test_psnr_is_its_definition() -> None:
    a, b = images()
    assert psnr(a, b) == pytest.approx(10 * np.log10(1 / np.mean((a.astype(float) - b) ** 2)), abs=1e-9)
    assert psnr(a, a) == MAX_PSNR_DB
    assert psnr(np.zeros((4, 4, 3), np.float32), np.full((4, 4, 3), 0.1, np.float32)) == pytest.approx(20.0, abs=1e-5)


def test_pixels_outside_the_mask_do_not_count() -> None:
    a, b = images()
    mask = np.zeros(a.shape[:2], bool)
    mask[5:10, 3:20] = True
    worse = np.where(mask[..., None], b, 1 - b)
    assert psnr(a, worse, mask) == pytest.approx(psnr(a[5:10, 3:20], b[5:10, 3:20]), abs=1e-9)
    assert psnr(a, b, np.zeros_like(mask)) is None


def test_ws_psnr_weights_rows_by_the_cosine_of_latitude() -> None:
    """Sun et al. 2017, equation for ERP: w = cos((j + 0.5 - H/2) pi / H)."""
    a, b = images(32, 64)
    rows = np.cos((np.arange(32) + 0.5 - 16) * np.pi / 32)[:, None] * np.ones((1, 64))
    error = ((a.astype(float) - b) ** 2).mean(axis=-1)
    expected = -10 * np.log10((error * rows).sum() / rows.sum())
    assert psnr(a, b, ErpCamera(64, 32).solid_angle()) == pytest.approx(expected, abs=1e-3)


def naive_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Wang et al. 2004 with explicit loops over windows."""
    k = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    window = np.outer(k, k) / np.outer(k, k).sum()
    values = []
    for c in range(3):
        for i in range(x.shape[0] - 10):
            for j in range(x.shape[1] - 10):
                p, q = x[i : i + 11, j : j + 11, c].astype(float), y[i : i + 11, j : j + 11, c].astype(float)
                mp, mq = (window * p).sum(), (window * q).sum()
                vp, vq = (window * (p - mp) ** 2).sum(), (window * (q - mq) ** 2).sum()
                cov = (window * (p - mp) * (q - mq)).sum()
                values.append((2 * mp * mq + 1e-4) * (2 * cov + 9e-4) / ((mp**2 + mq**2 + 1e-4) * (vp + vq + 9e-4)))
    return float(np.mean(values))


def test_ssim_is_its_definition() -> None:
    a, b = images()
    assert ssim(a, b) == pytest.approx(naive_ssim(a, b), abs=1e-6)
    assert ssim(a, a) == pytest.approx(1.0)


def test_ssim_of_masked_images_counts_whole_windows_only() -> None:
    a, b = images(40, 40)
    mask = np.zeros((40, 40), bool)
    mask[8:30, 10:38] = True
    expected = ssim(a[8:30, 10:38], b[8:30, 10:38])
    assert ssim(a, np.where(mask[..., None], b, 0.3), mask) == pytest.approx(expected, abs=1e-9)
    assert ssim(a, b, np.zeros((40, 40), bool)) is None
    assert ssim(a[:10], b[:10]) is None

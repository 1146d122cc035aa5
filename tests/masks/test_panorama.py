"""Small panoramas: filters that know seam and poles."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from panobench.geometry import so3_exp
from panobench.masks.panorama import Panorama

P = Panorama(128)


def waves(R: np.ndarray | None = None) -> np.ndarray:
    """Three smooth functions on the sphere (H, W, 3), turned by R."""
    d = P.rays if R is None else P.rays @ R.T
    return np.stack([np.sin(9 * d[..., k]) for k in range(3)], axis=-1).astype(np.float32)


def test_values_are_where_directions_say_over_seam_and_poles() -> None:
    x = waves()
    assert np.abs(P.at(x, 3.0 * P.rays) - x).max() < 2e-3
    R = so3_exp([1.1, -0.4, 2.0])
    assert np.abs(P.at(x, P.rays @ R.T) - waves(R)).max() < 0.03


def test_windows_are_equally_wide_at_all_latitudes() -> None:
    """The mean of a turned picture is the turned mean, nearly; windows of equal pixels are far from it."""
    x, R = waves(), so3_exp([np.pi / 2, 0, 0.3])  # the poles come to the horizon

    def off(mean: Callable[[np.ndarray], np.ndarray]) -> float:
        return float(np.abs(P.at(mean(x), P.rays @ R.T) - mean(waves(R))).mean())

    assert off(lambda y: P.mean(y, 7)) < 0.5 * off(lambda y: cv2.blur(y, (7, 7)))
    assert P.mean(np.ones((64, 128), np.float32), 7) == pytest.approx(1.0)


def test_shifts_are_angles() -> None:
    moved = P.shifted(waves(), 2.0, 0.0)
    assert np.abs(moved[32] - np.roll(waves(), -2, axis=1)[32]).max() < 0.01
    row = 8  # at 66 degrees a pixel to the right is 2.5 pixels wide
    stretch = 1 / np.cos((0.5 - (row + 0.5) / 64) * np.pi)
    u = (np.arange(128) + 2 * stretch) % 128
    expected = np.stack([np.interp(u, np.arange(128), waves()[row, :, k], period=128) for k in range(3)], axis=-1)
    assert np.abs(moved[row] - expected).max() < 0.01


def test_exposure_drops_out_and_what_differs_differs() -> None:
    rng = np.random.default_rng(0)
    picture = 90 + 60 * P.mean(rng.standard_normal((64, 128, 3)).astype(np.float32), 3) * 3
    other = 90 + 60 * P.mean(rng.standard_normal((64, 128, 3)).astype(np.float32), 3) * 3
    a, b, c = P.normalised(picture), P.normalised(0.6 * picture + 10), P.normalised(other)
    assert P.difference(a, b).mean() < 0.1 * P.difference(a, c).mean()

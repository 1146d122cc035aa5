"""Two circles are fitted to the valid pixels of an annular lens."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.datasets.palvio.calibration import published_calibration
from panobench.external.annulus import fit_annulus


def ring(x: float, y: float, inner: float, outer: float) -> np.ndarray:
    v, u = np.mgrid[:240, :320]
    distance = np.hypot(u - x, v - y)
    return (distance > inner) & (distance <= outer)


def test_the_published_ring_is_found_in_palvios_mask() -> None:
    """Its centre is not the lens's, and the image cuts the outer circle off above and below."""
    camera = published_calibration().camera
    values = camera.to_dict()
    found = fit_annulus(camera.valid_mask(), values["cx"] - 0.5, values["cy"] - 0.5)
    assert (found.x, found.y) == pytest.approx((640.991, 490.938), abs=0.05)
    assert (found.inner, found.outer) == pytest.approx((160, 500), abs=0.05)
    assert found.mismatch < 1e-4


def test_a_ring_without_a_hole_and_one_without_an_outer_edge() -> None:
    disc = fit_annulus(ring(160, 120, -1, 100), 161.0, 119.0)
    assert disc.inner == 0
    assert disc.outer == pytest.approx(100, abs=0.3)
    hole = fit_annulus(ring(160, 120, 40, 1e9), 161.0, 119.0)
    assert hole.inner == pytest.approx(40, abs=0.3)
    assert hole.outer >= np.hypot(161, 121) - 1
    everything = fit_annulus(np.ones((240, 320), dtype=bool), 161.0, 119.0)
    assert (everything.inner, everything.mismatch) == (0, 0)


def test_what_no_ring_describes_is_said() -> None:
    mask = ring(160, 120, 30, 110)
    mask[150:, 120:200] = False
    assert fit_annulus(mask, 160.0, 120.0).mismatch > 0.01

"""The polynomials that stand in for exp, log and atan2."""

import numpy as np
import pytest

from panobench.kernels.fast_math import atan2_fast, exp_fast, log_fast


def test_exp_and_log_are_good_to_float32() -> None:
    x = np.linspace(-30, 30, 4001).astype(np.float32)
    found = np.array([exp_fast(v) for v in x], np.float64)
    np.testing.assert_allclose(found, np.exp(x.astype(np.float64)), rtol=3e-6)
    y = np.exp(np.linspace(-20, 20, 4001)).astype(np.float32)
    np.testing.assert_allclose([log_fast(v) for v in y], np.log(y.astype(np.float64)), atol=2e-6, rtol=1e-6)


@pytest.mark.parametrize("x", [-1e4, 1e4])
def test_exp_stays_finite_far_out(x: float) -> None:
    found = exp_fast(np.float32(x))
    assert np.isfinite(found)
    assert found < 1e-30 if x < 0 else found > 1e30


def test_atan2_is_good_to_a_thousandth_of_a_pixel() -> None:
    angles = np.linspace(-np.pi + 1e-6, np.pi - 1e-6, 5001)
    found = [atan2_fast(np.float32(np.sin(a)), np.float32(np.cos(a))) for a in angles]
    assert np.abs(np.array(found) - angles).max() < 1e-6

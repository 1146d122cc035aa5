"""The polynomials that stand in for exp and log, and the small algebra at its edges."""

import numpy as np
import pytest

from panobench.kernels.fast_math import exp_fast, log_fast
from panobench.splat.algebra import rotation, tangent_basis


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


@pytest.mark.parametrize("m", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1e-12, 1.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.6, -0.8)])
def test_east_and_south_are_an_orthonormal_pair_everywhere(m: tuple[float, float, float]) -> None:
    basis = np.array(tangent_basis(m))
    np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(basis @ np.array(m), 0, atol=1e-9)


def test_a_quaternion_of_any_length_is_a_rotation() -> None:
    R, scale = rotation((0.2, -0.4, 0.6, 1.0))
    np.testing.assert_allclose(np.array(R) @ np.array(R).T, np.eye(3), atol=1e-12)
    assert scale == pytest.approx(1 / np.sqrt(0.04 + 0.16 + 0.36 + 1.0))

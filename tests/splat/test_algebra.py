"""The small algebra of the kernels at its edges."""

import numpy as np
import pytest

from panobench.splat.algebra import rotation, tangent_basis


@pytest.mark.parametrize("m", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1e-12, 1.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.6, -0.8)])
def test_east_and_south_are_an_orthonormal_pair_everywhere(m: tuple[float, float, float]) -> None:
    basis = np.array(tangent_basis(m))
    np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(basis @ np.array(m), 0, atol=1e-9)


def test_a_quaternion_of_any_length_is_a_rotation() -> None:
    R, scale = rotation((0.2, -0.4, 0.6, 1.0))
    np.testing.assert_allclose(np.array(R) @ np.array(R).T, np.eye(3), atol=1e-12)
    assert scale == pytest.approx(1 / np.sqrt(0.04 + 0.16 + 0.36 + 1.0))

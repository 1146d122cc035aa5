"""Groups of Gaussians that move by similarities of their own."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from panobench.geometry import Sim3, matrix_from_quaternion
from panobench.splat.gaussians import GaussianMap
from panobench.splat.motion import move


def test_each_group_moves_by_its_own_motion() -> None:
    rng = np.random.default_rng(3)
    n = 300
    g = GaussianMap(*(rng.normal(size=shape) for shape in ((n, 3), (n, 3), (n, 4), (n,), (n, 3))))
    groups = rng.integers(0, 3, n).astype(np.int32)
    motions = [Sim3(1.0, np.eye(3), np.zeros(3))] + [
        Sim3(scale, Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3)) for scale in (0.9, 1.2)
    ]
    moved = g.copy()
    move(moved, groups, motions)
    for k, motion in enumerate(motions):
        want, got = g.select(groups == k).transformed(motion), moved.select(groups == k)
        np.testing.assert_allclose(got.means, want.means, atol=1e-6)
        np.testing.assert_allclose(got.log_scales, want.log_scales, atol=1e-6)
        axes = matrix_from_quaternion(got.quats)
        np.testing.assert_allclose(axes, matrix_from_quaternion(want.quats), atol=1e-6)
        np.testing.assert_array_equal(got.colours, want.colours)

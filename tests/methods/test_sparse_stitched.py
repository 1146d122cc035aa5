"""Maps from stitched panoramas, adjusted as the two lenses saw them: known points, a camera that walks and turns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from panobench.cameras.two_lenses import TwoLenses
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, Keyframe, PointMap
from panobench.methods.sparse.refine import refined_poses
from panobench.methods.sparse.session import Session
from panobench.methods.sparse.stitched import undo_stitching

FOCAL, BASELINE = 160.0, 0.06
#: Median distance of the points from the camera, metres.
USUAL = 2.45
SCALE = 0.8  # of the map before anything tells its scale


def pose(k: int) -> np.ndarray:
    """T_wc of a camera that walks an arc and looks along it."""
    a = 0.09 * k
    return make_pose(
        so3_exp(np.array([0.02 * np.sin(k), a, 0.0])), np.array([1 - np.cos(a), 0.02 * np.sin(k), np.sin(a)])
    )


def session_of(lenses: TwoLenses) -> Session:
    """A map of 400 points and 14 keyframes with noise of 0.05 pixels, at another scale than the metre."""
    rng = np.random.default_rng(5)
    X = rng.normal(size=(400, 3))
    X *= rng.uniform(1.2, 3.5, (400, 1)) / np.linalg.norm(X, axis=1, keepdims=True)
    m = PointMap(1)
    ids = m.add(len(X), position=SCALE * X, state=ACTIVE)
    session = Session(m)
    for k in range(14):
        T = invert_pose(pose(k))
        Y = X @ T[:3, :3].T + T[:3, 3]
        depth = np.linalg.norm(Y, axis=1)
        b = lenses.stitched(Y / depth[:, None], 1 / depth) + rng.normal(scale=0.05 / FOCAL, size=X.shape)
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        T[:3, 3] *= SCALE
        m.keyframes.append(Keyframe(k, k, T, ids.copy(), b))
        session.records.append(FrameRecord(k, k / 10, k, np.eye(4), ids.copy(), b.astype(np.float32)))
    return session


@pytest.mark.parametrize(("distance", "stitch_m"), [(2.0, 2.0), (USUAL, None)])
def test_poses_are_those_of_the_middle_and_the_scale_is_that_of_the_lenses(
    distance: float, stitch_m: float | None
) -> None:
    session = session_of(TwoLenses(BASELINE, 1 / distance))
    extra: dict[str, Any] = {}
    config = SparseConfig(stitch_mm=1e3 * BASELINE, stitch_m=stitch_m, min_inliers=10)
    session.grew(undo_stitching(session.map, session.records, config, FOCAL, extra))
    found = refined_poses(session, config, FOCAL)
    walked = [float(np.linalg.norm(T[13][:3, 3] - T[0][:3, 3])) for T in (found, [pose(k) for k in range(14)])]
    assert extra["stitch_m"] == pytest.approx(distance, rel=0.05)
    assert walked[0] / walked[1] == pytest.approx(1.0, abs=0.01 if stitch_m else 0.06)
    assert 0 < extra["scale_sigma_percent"] < 10
    for k in range(14):
        relative = invert_pose(found[0]) @ found[k]
        true = invert_pose(pose(0)) @ pose(k)
        np.testing.assert_allclose(relative[:3, :3], true[:3, :3], atol=1.5e-3)
        np.testing.assert_allclose(relative[:3, 3] * walked[1] / walked[0], true[:3, 3], atol=3e-3)

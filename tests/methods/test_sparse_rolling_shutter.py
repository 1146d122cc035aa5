"""Readout from bearings: known points seen by a camera that swings about its vertical while its rows are read."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.row_times import rates_along, row_times
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, Keyframe, PointMap
from panobench.methods.sparse.pose import pose_errors
from panobench.methods.sparse.rolling_shutter import RowBearings, estimate_readout

CAMERA, FOCAL = ErpCamera(512, 256), 81.0
RATE = np.deg2rad(150.0)
TIMES = np.arange(16) / 15


def pose(t: float) -> np.ndarray:
    """T_wc of a camera that walks along x and swings with a period of two seconds."""
    return make_pose(so3_exp(np.array([0.0, RATE / np.pi * np.sin(np.pi * t), 0.0])), np.array([0.5 * t, 0.0, 0.2 * t]))


def seen_along(t: float, X: np.ndarray, readout_s: float) -> np.ndarray:
    """Bearings (N, 3) of points, each from where the camera is when the point's own row is read."""
    rows = np.zeros(len(X))
    for _ in range(4):
        T = np.stack([invert_pose(pose(t + readout_s * row)) for row in rows])
        b = np.einsum("nij,nj->ni", T[:, :3, :3], X) + T[:, :3, 3]
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        rows = row_times(CAMERA, b[:, None])[:, 0]
    return b


def world(readout_s: float, noise_px: float = 0.1) -> tuple[PointMap, list[FrameRecord]]:
    """A map of 300 points and 16 keyframes, adjusted as if the shutter were global; a record of each."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 3))
    X *= rng.uniform(1.5, 4.0, (300, 1)) / np.linalg.norm(X, axis=1, keepdims=True)
    m = PointMap(1)
    ids = m.add(len(X), position=X, state=ACTIVE)
    records = []
    for k, t in enumerate(TIMES):
        b = seen_along(float(t), X, readout_s) + rng.normal(scale=noise_px / FOCAL, size=X.shape)
        b /= np.linalg.norm(b, axis=1, keepdims=True)
        m.keyframes.append(Keyframe(k, k, invert_pose(pose(float(t))), ids, b))
        records.append(FrameRecord(k, float(t), k, np.eye(4), ids, b.astype(np.float32)))
    return m, records


@pytest.mark.parametrize("readout_ms", [0.0, 5.0, 15.0, -15.0, 25.0])
def test_the_readout_is_found_with_the_poses_and_a_global_shutter_has_none(readout_ms: float) -> None:
    m, records = world(1e-3 * readout_ms)
    before = m.position.copy()
    rows = RowBearings(CAMERA, m, records)
    rows.follow(np.stack([invert_pose(k.T_cw) for k in m.keyframes]))
    found = estimate_readout(rows, m, FOCAL)
    assert 1e3 * found.best_s == pytest.approx(readout_ms, abs=0.5)
    assert found.seconds == (0.0 if readout_ms == 0 else found.best_s)
    np.testing.assert_array_equal(m.position, before)


def test_bearings_are_turned_to_where_points_are_seen_from_the_middle() -> None:
    m, records = world(0.02, noise_px=0.0)
    rows = RowBearings(CAMERA, m, records)
    rows.follow(np.stack([pose(float(t)) for t in TIMES]))

    def off() -> float:
        return max(float(np.median(pose_errors(k.T_cw, m.position, k.bearings, FOCAL))) for k in m.keyframes)

    before = off()
    rows.turn(0.02)
    assert off() < 0.25 * before  # the rest is what the camera travelled meanwhile
    np.testing.assert_allclose(records[3].bearings, m.keyframes[3].bearings, atol=1e-6)


def test_a_camera_that_hardly_turns_says_nothing() -> None:
    m, records = world(0.015)
    rows = RowBearings(CAMERA, m, records)
    rows.follow(np.tile(np.eye(4), (len(TIMES), 1, 1)))
    assert estimate_readout(rows, m, FOCAL).seconds == 0
    assert np.abs(rates_along(TIMES, np.tile(np.eye(4), (len(TIMES), 1, 1)))).max() == 0

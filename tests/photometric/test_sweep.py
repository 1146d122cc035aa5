"""Costs of the plane sweep, against the errors of single depths."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.photometric.stereo import WorkingScale
from panobench.photometric.sweep import padded, reprojection_error, sweep_cost

CAMERAS = [ErpCamera(64, 32), PinholeCamera(48, 40, 30.0, 31.0, 23.0, 20.5)]


@pytest.mark.parametrize("camera", CAMERAS, ids=["erp", "pinhole"])
def test_every_shell_costs_what_its_depth_alone_would(camera: Camera) -> None:
    rng = np.random.default_rng(3)
    scale = WorkingScale.of(camera, camera.width)
    h, w = scale.valid.shape
    reference = rng.random((h, w), np.float32)
    reference[3, 5] = np.nan
    frames = rng.random((3, h, w), np.float32)
    frames[1, 10:14, 20:30] = np.nan
    R = np.stack([np.eye(3, dtype=np.float32)] * 3)
    t = rng.normal(scale=0.3, size=(3, 3)).astype(np.float32)
    depths = np.array([0.4, 1.0, 2.5, 30.0], np.float32)
    truncation = np.float32(0.4)
    cost = np.empty((h, w, len(depths)), np.float32)
    images = padded(frames, camera.kind == "erp")
    sweep_cost(reference, scale.rays, images, R, t, depths, scale.code, scale.cam, truncation, 0, 3, cost)
    seen = 0.0
    for k, depth in enumerate(depths):
        alone = np.empty((h, w), np.float32)
        constant = np.full((h, w), depth, np.float32)
        reprojection_error(reference, scale.rays, frames, R, t, constant, scale.code, scale.cam, truncation, alone)
        unseen = ~np.isfinite(alone)
        # A sample within rounding of a border may fall on either side of it.
        other = np.abs(cost[..., k] - alone) > 1e-3
        assert np.count_nonzero(other & ~unseen) < 0.01 * other.size
        assert np.allclose(cost[..., k][unseen], 0.5 * truncation)
        seen = max(seen, 1 - float(unseen.mean()))
    assert seen > 0.9

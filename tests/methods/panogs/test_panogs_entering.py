"""Depth of what enters a narrow view."""

from __future__ import annotations

import numpy as np
import pytest
from panogs_options import configured

from panobench.cameras.pinhole import PinholeCamera
from panobench.depth.simple import OracleDepth
from panobench.methods.base import MethodContext
from panobench.methods.panogs.fixed_lag import stage
from panobench.methods.panogs.fixed_lag.entering import parallax
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame
from panobench.methods.panogs.fixed_lag.swept_depth import SweptDepth
from panobench.methods.panogs.method import PanogsMethod
from panobench.photometric.stereo import WorkingScale
from panobench.testing.sequences import TinySequence, rotating_pose, smooth_pose
from panobench.types import Frame

CAMERA = PinholeCamera.from_fov(144, 120, 60)


def test_parallax_is_that_of_the_frames_that_see_a_pixel() -> None:
    scale = WorkingScale.of(CAMERA, 256)
    shape = scale.valid.shape
    depth = np.full(shape, 2.0, np.float32)
    aside, away = np.eye(4), np.eye(4)
    aside[0, 3] = -0.2
    away[:3, :3] = np.diag([-1.0, 1.0, -1.0])  # looks back
    nothing = np.zeros(shape, np.float32)
    target = BufferedFrame(0, np.zeros((*shape, 3), np.uint8), nothing, nothing)
    swept = SweptDepth(depth, depth, target, np.stack([nothing, nothing]), np.stack([aside, away]))
    angle, count = parallax(scale, swept)
    middle = shape[0] // 2, shape[1] // 2
    assert angle[middle] == pytest.approx(np.arctan(0.1), abs=2e-3)
    assert count[middle] == 1
    assert (count <= 1).all()
    # The camera has moved to the right: it does not see what is farthest to the left any more.
    assert count[middle[0], 0] == 0
    assert angle[middle[0], 0] == 0


def known_depth(monkeypatch: pytest.MonkeyPatch, at_once: bool) -> np.ndarray:
    """Log of the map's depth over the true one, (H, W), in the last frame of a camera that turns by 4 degrees a frame.

    NaN where the map has nothing. Nothing is guessed; at_once: what enters is swept over the frames before.
    """
    monkeypatch.setattr(stage, "ENTERING_SHARE", 0.02 if at_once else 1.0)
    sequence = TinySequence(CAMERA, 14, pose=lambda t: smooth_pose(t) @ rotating_pose(t))
    quick = configured(mapping__iterations=4, start__iterations=10, factors__enabled=False, seeding__guess_share=1.0)
    method = PanogsMethod(quick)
    method.start(CAMERA, MethodContext(make_depth=OracleDepth))
    for i in range(len(sequence)):
        method.track(Frame(i, float(sequence.times[i]), sequence.image(i), depth=sequence.depth(i)))
    newest = len(sequence) - 1
    render = method.mapper.renderer.forward(method.mapper.map.gaussians, method.trajectory[newest], sloped=True)
    truth = sequence.depth(newest)
    assert truth is not None
    return np.log(render.expected_depth(0.5) / truth)


def test_what_enters_a_narrow_view_has_its_depth_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    later, once = known_depth(monkeypatch, at_once=False), known_depth(monkeypatch, at_once=True)
    assert np.isfinite(once).mean() > np.isfinite(later).mean() + 0.05
    assert np.nanmedian(np.abs(once)) < 0.05

"""What panogs keeps does not grow with the length of the run."""

from __future__ import annotations

import numpy as np

from panobench.cameras.erp import ErpCamera
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.system import PanogsMethod
from panobench.methods.panogs.views import View
from panobench.splat.render import Renderer
from panobench.testing.sequences import TinySequence, erp_camera
from panobench.types import Frame


def view(number: int) -> View:
    return View(number, np.full((4, 8, 3), number, np.uint8), np.eye(4))


def test_the_pool_of_frames_is_bounded() -> None:
    camera = ErpCamera(8, 4)
    mapper = Mapper(camera, Renderer(camera), PanogsConfig(frame_pool=6), seed=0)
    views = [view(k) for k in range(40)]
    for v in views:
        mapper.remember(v)
    kept = [v for v in views if v.image.size]
    assert kept == mapper.frames
    assert len(kept) == 6
    assert all(int(v.image.mean()) == v.index for v in kept)
    assert all(v.image.base is None for v in views if not v.image.size)  # nothing hangs on to what was dropped


def test_old_keyframes_keep_a_pose_and_a_thumbnail_only() -> None:
    sequence = TinySequence(erp_camera(64), 60)
    config = PanogsConfig(mapping_iterations=1, initial_iterations=1, frame_pool=5, window=3, sweep=False, smooth=False)
    method = PanogsMethod(config)
    method.start(sequence.camera, MethodContext())
    for i in range(60):
        method.track(Frame(i, i / 10, sequence.image(i)))
    keyframes, window = method.mapper.keyframes, method.mapper.window
    assert len(keyframes) > 10
    assert method.places.count == len(keyframes)
    assert sum(v.image.size > 0 for v in keyframes) <= 3 + 5
    assert all(v.touched is None for v in keyframes if v not in window)
    assert method.places.nbytes <= 9000 * max(64, 1.5 * len(keyframes))

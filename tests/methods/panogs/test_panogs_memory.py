"""What panogs keeps does not grow with the length of the run."""

from __future__ import annotations

import numpy as np
from panogs_options import configured

from panobench.cameras.erp import ErpCamera
from panobench.methods.base import MethodContext
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.splat.render import Renderer
from panobench.testing.sequences import TinySequence, erp_camera
from panobench.types import Frame


def view(number: int) -> View:
    return View(number, np.full((4, 8, 3), number, np.uint8), np.eye(4))


def test_the_pool_of_frames_is_bounded() -> None:
    camera = ErpCamera(8, 4)
    mapper = Mapper(camera, Renderer(camera), configured(mapping__frame_pool=6), AnchoredTrajectory(), seed=0)
    views = [view(k) for k in range(40)]
    for v in views:
        mapper.remember(v)
    kept = [v for v in views if v.image.size]
    assert kept == mapper.trajectory.frames
    assert len(kept) == 6
    assert all(int(v.image.mean()) == v.index for v in kept)
    assert all(v.image.base is None for v in views if not v.image.size)  # nothing hangs on to what was dropped


def test_old_keyframes_keep_a_pose_and_a_thumbnail_only() -> None:
    sequence = TinySequence(erp_camera(64), 60)
    config = configured(
        mapping__iterations=1, start__iterations=1, mapping__frame_pool=5, keyframes__window=3, fixed_lag__sweep=False,
        fixed_lag__smooth=False,
    )  # fmt: skip
    method = PanogsMethod(config)
    method.start(sequence.camera, MethodContext())
    for i in range(60):
        method.track(Frame(i, i / 10, sequence.image(i)))
    keyframes, window = method.trajectory.keyframes, method.mapper.window
    assert len(keyframes) > 10
    assert method.places.count == len(keyframes)
    assert sum(v.image.size > 0 for v in keyframes) <= 3 + 5
    assert all(v.seen is None for v in keyframes if v not in window)
    assert method.places.nbytes <= 9000 * max(64, 1.5 * len(keyframes))

"""Fixed-lag smoothing, depth of new regions, and carving what is wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from panogs_options import configured

from panobench.datasets.base import FrameSequence
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth.bootstrap import BootstrapDepth
from panobench.geometry import invert_pose
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import FixedLagOptions
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame, FrameBuffer
from panobench.methods.panogs.fixed_lag.lag_smoother import LagSmoother
from panobench.methods.panogs.fixed_lag.swept_depth import DepthSweep, SweptDepth
from panobench.methods.panogs.mapping.map_optimiser import MapOptimiser
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric.pyramid import luma_of_frame, pyramid
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.types import Frame

WIDTH, FRAMES = 256, 13


@lru_cache(maxsize=1)
def room() -> FrameSequence:
    return RoomsDataset().open("tiny", width=WIDTH)


@lru_cache(maxsize=1)
def remembered() -> tuple[FrameBuffer, BufferedFrame, tuple[BufferedFrame, ...]]:
    sequence = room()
    buffer = FrameBuffer(sequence.camera, FixedLagOptions(lag=FRAMES - 1))
    for i in range(FRAMES):
        image = sequence.image(i)
        levels = pyramid(luma_of_frame(image, sequence.camera.valid_mask()))
        buffer.add(Frame(i, i / 15, image), levels, np.full(3, float(i)), 1.0)
    back = buffer.split(FRAMES - 1)
    assert back is not None
    return buffer, back[0], tuple(back[1])


def truth() -> list[np.ndarray]:
    groundtruth = room().groundtruth
    assert groundtruth is not None
    first = invert_pose(groundtruth.T_wc[0])
    return [first @ T for T in groundtruth.T_wc[:FRAMES]]


def tracked(poses: list[np.ndarray]) -> AnchoredTrajectory:
    """Every frame with its pose; the first is the keyframe."""
    trajectory, first = AnchoredTrajectory(), View(0, np.zeros((1, 1, 3), np.uint8), poses[0])
    trajectory.add_keyframe(first, 0.0)
    for i, T in enumerate(poses[1:], 1):
        trajectory.add(i, i / 15, T, first)
    return trajectory


def shortened(poses: list[np.ndarray], factor: float, first: int = 0) -> list[np.ndarray]:
    out = [T.copy() for T in poses]
    for T in out[first:]:
        T[:3, 3] *= factor
    return out


def lengths(poses: dict[int, np.ndarray]) -> np.ndarray:
    return np.array([np.linalg.norm(poses[i][:3, 3]) for i in sorted(poses) if i >= FRAMES // 2])


def test_short_poses_get_the_scale_of_the_depth() -> None:
    buffer, target, others = remembered()
    exact = truth()
    short = shortened(exact, 0.96)
    depth = room().depth(0)
    assert depth is not None
    refined = (
        LagSmoother(buffer.fine_scale, FixedLagOptions()).refine(target, list(others), tracked(short), depth, 1.0).poses
    )
    ratio = lengths(refined) / lengths(dict(enumerate(exact)))
    assert np.all(np.abs(ratio - 1) < 0.012)


def test_refined_frames_carry_the_scale_to_the_next_lag() -> None:
    buffer, target, others = remembered()
    exact = truth()
    mixed = shortened(exact, 0.94, first=9)
    depth = room().depth(0)
    assert depth is not None
    smoother = LagSmoother(buffer.fine_scale, FixedLagOptions())
    smoother.mark_refined(list(others[:8]))
    refined = smoother.refine(target, list(others), tracked(mixed), 0.9 * depth, 3.0).poses
    ratio = lengths(refined) / lengths(dict(enumerate(exact)))
    assert np.all(np.abs(ratio - 1) < 0.015)


def test_a_wrong_surface_is_disproved_where_it_shows_and_nowhere_else() -> None:
    buffer, target, others = remembered()
    exact = truth()
    depth = room().depth(0)
    assert depth is not None
    T_fr = np.stack([invert_pose(exact[f.index]) for f in others])
    swept = SweptDepth(depth, np.ones_like(depth), target, np.stack([f.luma for f in others]), T_fr)
    mapped = depth.copy()
    patch = np.zeros(depth.shape, bool)
    patch[48:88, 60:120] = True
    mapped[patch] *= 0.5
    disproved = DepthSweep(room().camera, buffer.sweep_scale, FixedLagOptions()).disproved(swept, mapped)
    assert disproved[patch].mean() > 0.25
    assert not disproved[~patch].any()


def test_carving_removes_a_veil_and_leaves_the_rest() -> None:
    sequence = room()
    camera, depth = sequence.camera, sequence.depth(0)
    assert depth is not None
    mapper = Mapper(camera, Renderer(camera), configured(start__iterations=0), AnchoredTrajectory(), seed=0)
    view = View(0, sequence.image(0), np.eye(4))
    mapper.initialise(view, 0.0, depth)
    behind = len(mapper.map)
    ray = camera.rays()[64, 128]
    veil = GaussianMap(
        (0.4 * depth[64, 128] * ray + np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]])).astype(np.float32),
        np.full((2, 3), np.log(0.1), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        np.full(2, 4.0, np.float32),
        np.full((2, 3), 0.5, np.float32),
    )
    mapper.map.append(veil, 0)
    render = mapper.renderer.forward(mapper.map.gaussians, view.T_wc)
    covered = render.depth < 0.8 * depth
    dropped = mapper.carve(view, render, covered, depth)
    assert 2 <= dropped <= 2 + 0.02 * behind
    assert not (np.abs(mapper.map.gaussians.means[:, None] - veil.means[None]).max(axis=-1) < 1e-6).any()


def test_only_frames_that_may_be_mapped_receive_depth() -> None:
    buffer = FrameBuffer(room().camera, FixedLagOptions(lag=4))
    levels = [np.zeros((WIDTH // 2, WIDTH), np.float32)]
    for i in range(5):
        frame = Frame(i, i / 15, np.zeros((WIDTH // 2, WIDTH, 3), np.uint8), mappable=i not in (0, 1, 4))
        buffer.add(frame, levels, np.full(3, float(i)), 1.0)
    back = buffer.split(4)
    assert back is not None
    assert back[0].index == 2
    assert [f.index for f in back[1]] == [3, 4]
    assert [f.index for f in buffer.until_mappable()] == [0, 1, 2, 3]
    assert buffer.split(5) is None
    assert buffer.split(1) is not None
    buffer.add(Frame(5, 0.4, np.zeros((WIDTH // 2, WIDTH, 3), np.uint8), mappable=False), levels, np.full(3, 9.0), 1.0)
    assert buffer.split(1) is None


def test_the_map_never_sees_a_held_out_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[int] = set()
    for owner, name in ((Mapper, "seed"), (MapOptimiser, "step"), (Mapper, "split")):
        whole = getattr(owner, name)

        def spied(self: Any, view: View, *rest: Any, whole: Any = whole, **named: Any) -> Any:
            seen.add(view.index)
            return whole(self, view, *rest, **named)

        monkeypatch.setattr(owner, name, spied)
    config = configured(mapping__iterations=2, start__iterations=5, fixed_lag__new_share=0.0, keyframes__interval=2)
    method = PanogsMethod(config)
    method.start(room().camera, MethodContext(make_depth=BootstrapDepth))
    held = set(range(2, len(room()), 3))
    for k, frame in enumerate(room().frames()):
        method.track(replace(frame, mappable=k not in held))
    method.finish()
    assert len(seen) > 10
    assert not seen & held


def test_what_the_last_frames_saw_new_is_drawn() -> None:
    """A doorway passed at the very end: no frame follows that could give it depth."""
    sequence = room()
    method = PanogsMethod(configured(mapping__final_iterations=0))
    method.start(sequence.camera, MethodContext(make_depth=BootstrapDepth))
    for frame in sequence.frames():
        method.track(frame)
    m, last = method.mapper, method.lag.buffer.before(0)
    T_wc = method.trajectory[last.index]
    gone = np.linalg.norm(m.map.gaussians.means - (T_wc[:3, :3] @ [0.0, 0.0, 1.0] * 2 + T_wc[:3, 3]), axis=1) < 1.0
    assert gone.any()
    m.map.drop(gone)

    def thin() -> float:
        return float(m.weights[m.thin(m.renderer.forward(m.map.gaussians, method.trajectory[last.index]))].sum())

    before = thin()
    assert before > 0.01
    method.finish()
    assert thin() < 0.4 * before

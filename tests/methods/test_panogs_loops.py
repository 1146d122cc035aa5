"""Loop closure: measuring a drift between two parts of a map, spreading it, and moving everything by it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from panobench.geometry import Sim3, invert_pose, make_pose, so3_exp
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.dormant import AFTER, Dormant, anchors_of
from panobench.methods.panogs.loops import DRIFT_MIN, OLD, Loop, LoopCloser, carry_out, move_gaussians
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.places import Places, Thumbnail
from panobench.methods.panogs.relocalise import Relocaliser
from panobench.methods.panogs.system import PanogsMethod
from panobench.methods.panogs.tracker import Tracker
from panobench.methods.panogs.views import View
from panobench.photometric.pyramid import luma_of_frame, pyramid
from panobench.splat.render import Renderer
from panobench.testing.sequences import TinySequence, erp_camera
from panobench.types import Frame

WIDTH, KEYFRAMES = 128, OLD + 12
DRIFT = Sim3(1.06, so3_exp([0.01, 0.05, -0.02]), np.array([0.08, -0.03, 0.05]))
BLANK = np.zeros((1, 1, 3), np.uint8)


@lru_cache(maxsize=1)
def scene() -> tuple[TinySequence, Mapper, Tracker]:
    """A map seeded evenly from the first frame and its true depth; fitting it to images would move its depth."""
    camera = erp_camera(WIDTH)
    sequence, config = TinySequence(camera, 40), PanogsConfig(densify=False)
    mapper = Mapper(camera, Renderer(camera), config, seed=0)
    depth = sequence.depth(0)
    assert depth is not None
    mapper.initialise(View(0, sequence.image(0), sequence.pose_at(0.0)), depth)
    return sequence, mapper, Tracker(camera, Renderer(camera, stop=1e-3), config)


def closer_for(tracker: Tracker, places: Places) -> LoopCloser:
    return LoopCloser(tracker, places, Relocaliser(tracker, places).descend)


def look(seed: int = 0, drift: Sim3 = DRIFT, span: float = 0.3) -> Loop | None:
    """Keyframe 0 saw the room and its map sleeps; the last five see it again, in a world that has drifted.

    seed: of the room they see; span: seconds of motion between them.
    """
    sequence, seeded, tracker = scene()
    camera, places = sequence.camera, Places(sequence.camera)
    seen = TinySequence(camera, 40, seed=seed)
    times = 0.4 + span * np.arange(5)

    def thumbnail(source: TinySequence, t: float) -> Thumbnail:
        image = source.image_from(source.pose_at(t))
        return places.thumbnail(pyramid(luma_of_frame(image, camera.valid_mask()))[-1])

    mapper = Mapper(camera, Renderer(camera), PanogsConfig(), seed=0)
    mapper.keyframes = [View(k, BLANK, sequence.pose_at(0.0)) for k in range(KEYFRAMES)]
    places.add(thumbnail(sequence, 0.0))
    while places.count < KEYFRAMES:
        places.add(np.zeros_like(thumbnail(sequence, 0.0)))
    for view, t in zip(mapper.keyframes[-5:], times):
        view.image = seen.image_from(seen.pose_at(t))
        view.T_wc = drift.inverse().apply_poses(seen.pose_at(t))
    mapper.window = mapper.keyframes[:-6:-1]
    asleep = seeded.map
    return closer_for(tracker, places).look(
        thumbnail(seen, times[-1]), asleep, np.zeros(len(asleep), np.int64), mapper
    )  # fmt: skip


@pytest.mark.parametrize("drift", [DRIFT, Sim3(0.9, so3_exp([0, 0.3, 0]), np.array([0.9, 0.0, -0.5]))])
def test_the_drift_from_the_sleeping_map_is_measured_with_its_scale(drift: Sim3) -> None:
    loop = look(drift=drift)
    assert loop is not None
    assert (loop.old, loop.new) == (0, KEYFRAMES - 1)
    # Poses aligned to a map seen from elsewhere fall short by a percent or two.
    assert abs(np.log(loop.drift.scale / drift.scale)) < 0.03
    points = drift.inverse().apply_points(np.array([[1.0, 0.5, 0.3], [-1.0, 0.2, 1.0], [0.0, -0.5, -1.0]]))
    assert np.abs(loop.drift.apply_points(points) - drift.apply_points(points)).max() < 0.03
    assert loop.size > 10 * DRIFT_MIN


def test_a_map_that_has_not_drifted_gives_next_to_no_drift() -> None:
    loop, drifted = look(drift=Sim3(1.0, np.eye(3), np.zeros(3))), look()
    assert loop is not None
    assert drifted is not None
    assert loop.size < 0.2 * drifted.size
    assert abs(np.log(loop.drift.scale)) < 0.03


def test_another_room_closes_no_loop() -> None:
    assert look(seed=99) is None


def test_a_camera_that_stands_still_waits_before_it_says_what_the_scale_is() -> None:
    assert look(span=0.01) is None


def test_a_closed_loop_takes_the_drift_out_of_the_whole_lap() -> None:
    n = 40
    angle = 2 * np.pi * np.arange(n) / (n - 1)
    truth = [make_pose(so3_exp([0, a, 0]), [2 * np.sin(a), 0, 2 - 2 * np.cos(a)]) for a in angle]
    # Every step is 0.4% longer than the last and turns a little too far.
    drifted, scale = [truth[0]], 1.0
    for k in range(1, n):
        step = invert_pose(truth[k - 1]) @ truth[k]
        scale *= 1.004
        step[:3, 3] *= scale
        step[:3, :3] = step[:3, :3] @ so3_exp([0, 1e-3, 0])
        drifted.append(drifted[-1] @ step)
    keyframes = [View(k, BLANK, T) for k, T in enumerate(drifted)]
    closer = closer_for(scene()[2], Places(scene()[0].camera))
    closer.ties = [(k - 1, k, 1.0) for k in range(1, n)] + [(k - 3, k, 0.5) for k in range(3, n)]
    R = truth[-1][:3, :3] @ drifted[-1][:3, :3].T
    drift = Sim3(1 / scale, R, truth[-1][:3, 3] - R @ drifted[-1][:3, 3] / scale)
    moves = closer.spread(Loop(0, n - 1, drift, 1.0, np.ones(n, bool)), keyframes)
    before = np.linalg.norm([a[:3, 3] - b[:3, 3] for a, b in zip(drifted, truth)], axis=1)
    after = np.linalg.norm([m.apply_poses(a)[:3, 3] - b[:3, 3] for m, a, b in zip(moves, drifted, truth)], axis=1)
    assert before.max() > 0.25
    assert after.max() < 0.2 * before.max()
    assert after[-1] < 0.02
    assert abs(moves[-1].scale * scale - 1) < 0.02


def test_gaussians_follow_their_anchor_alone() -> None:
    seeded = scene()[1].map
    gaussians = seeded.copy()
    anchors = np.arange(len(gaussians)) % 2
    expected = seeded.transformed(DRIFT)
    move_gaussians(gaussians, anchors, [Sim3(1.0, np.eye(3), np.zeros(3)), DRIFT])
    for mine, moved, still in zip(gaussians.arrays(), expected.arrays(), seeded.arrays()):
        assert np.allclose(mine[1::2], moved[1::2], atol=1e-5)
        assert np.allclose(np.abs(mine[::2]), np.abs(still[::2]), atol=1e-5)


def test_moving_everything_alike_changes_no_picture() -> None:
    sequence = scene()[0]
    method = PanogsMethod(PanogsConfig(mapping_iterations=3, initial_iterations=10, final_iterations=0))
    method.start(sequence.camera, MethodContext())
    for i in range(12):
        method.track(Frame(i, i / 10, sequence.image(i)))
    assert len(method.mapper.keyframes) > 1
    poses = method.finish().trajectory.T_wc
    held = {view.index: view.T_wc for view in method.mapper.frames}
    picture = method.render(sequence.camera, poses[7])
    carry_out([DRIFT] * len(method.mapper.keyframes), method.mapper, method.dormant, method.records)
    moved = method.finish().trajectory.T_wc
    assert np.allclose(moved, DRIFT.apply_poses(poses), atol=1e-9)
    assert all(np.allclose(v.T_wc, DRIFT.apply_poses(held[v.index])) for v in method.mapper.frames)
    again = method.render(sequence.camera, moved[7])
    assert picture is not None
    assert again is not None
    assert np.abs(again - picture).mean() < 2e-3
    assert anchors_of(method.mapper.born).max() < len(method.mapper.keyframes)


def test_groups_out_of_sight_sleep_and_wake_with_their_optimiser_state() -> None:
    camera = erp_camera(WIDTH)
    seeded = scene()[1].map
    n = len(seeded)
    mapper = Mapper(camera, Renderer(camera), PanogsConfig(), seed=0)
    mapper.append(seeded.concat(seeded), np.repeat([1, 2], n).astype(np.int32))
    mapper.adam.m[:] = np.arange(2 * n)[:, None]
    mapper.adam.steps[:] = np.arange(2 * n)
    dormant, slept = Dormant(), 0
    second_only = np.repeat([0, 1], n).astype(np.int32)
    for k in range(AFTER + 3):
        mapper.keyframes.append(View(k, BLANK, np.eye(4), touched=second_only))
        slept += dormant.update(mapper, second_only if not slept else np.ones(n, np.int32))
    assert slept == n == len(dormant) == len(mapper.map)
    assert np.array_equal(mapper.adam.steps, np.arange(n, 2 * n))
    assert len(dormant.whole(mapper)) == 2 * n
    none = np.zeros(len(mapper.keyframes), bool)
    assert dormant.wake(mapper, none) == 0
    none[0] = True
    assert dormant.wake(mapper, none) == n
    assert np.array_equal(mapper.adam.steps, np.r_[n : 2 * n, 0:n])
    assert np.array_equal(mapper.adam.m[:, 3], np.r_[n : 2 * n, 0:n])
    assert np.array_equal(mapper.map.means[n:], seeded.means)
    assert len(dormant) == 0
    assert dormant.update(mapper, np.ones(2 * n, np.int32)) == 0

"""The trajectory behind PanoGS's tracker: which windows there are, who follows, how much is remembered."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.datasets.rooms import RoomsDataset
from panobench.geometry import invert_pose, se3_exp, se3_log, umeyama
from panobench.methods.panogs import backend
from panobench.methods.panogs.backend import Backend, followed, moved_by
from panobench.methods.panogs.loops import move_gaussians
from panobench.photometric.pyramid import F32, luma_of_frame
from panobench.photometric.stereo import WorkingScale
from panobench.splat.gaussians import GaussianMap

Array = NDArray[np.float64]
FRAMES = 20


@lru_cache(maxsize=1)
def room() -> tuple[WorkingScale, list[F32], list[F32], Array]:
    """Working scale, luma, depth and poses of the first frames."""
    sequence = RoomsDataset().open("tiny", width=256)
    assert sequence.groundtruth is not None
    scale = WorkingScale.of(sequence.camera, 256)
    luma = [luma_of_frame(sequence.image(i), scale.valid) for i in range(FRAMES)]
    depth = [sequence.depth(i) for i in range(FRAMES)]
    T_wc = invert_pose(sequence.groundtruth.T_wc[0]) @ sequence.groundtruth.T_wc[:FRAMES]
    return scale, luma, [d for d in depth if d is not None], T_wc


def run(
    poses: list[Array], monkeypatch: pytest.MonkeyPatch, reach: int = 8, every: int = 4, young: float = 1.0
) -> Backend:
    """``young``: the factor by which depth is wrong when a window is made for the first time."""
    monkeypatch.setattr(backend, "REACH", reach)
    monkeypatch.setattr(backend, "AGAIN", 2 * reach)
    monkeypatch.setattr(backend, "EVERY", every)
    scale, luma, depth, _ = room()
    b, visited = Backend(scale), set()
    for i in range(FRAMES):
        b.add(i, luma[i])
        while (k := b.due(at_the_end=i == FRAMES - 1)) is not None:
            b.adjust(k, lambda n: poses[n], depth[k] * np.float32(1.0 if k in visited else young))
            visited.add(k)
    return b


def misfit(T: Array, truth: Array) -> float:
    s = umeyama(T[:, :3, 3], truth[:, :3, 3])
    return float(np.sqrt(((s.apply_points(T[:, :3, 3]) - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def test_disturbed_poses_are_mended_and_the_first_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = room()[3]
    noise = np.random.default_rng(0).normal(0, 0.003, (FRAMES, 6))
    noise[0] = 0
    start = list(truth @ se3_exp(noise))
    fit = run(start, monkeypatch).fit(lambda i: start[i], 2.0)
    after = np.stack([fit.poses[i] for i in range(FRAMES)])
    assert misfit(after, truth) < 0.4 * misfit(np.stack(start), truth)
    np.testing.assert_allclose(after[0], start[0], atol=1e-12)
    assert abs(fit.stretch - 1) < 0.02


def test_every_frame_is_in_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    b = run(list(room()[3]), monkeypatch)
    assert [w.reference for w in b.windows] == [0, 4, 8, 12, 16]
    assert set().union(*(set(w.frames.tolist()) for w in b.windows)) == set(range(FRAMES))


@pytest.mark.parametrize(("young", "twice"), [(1.0, False), (1.005, False), (1.05, True)])
def test_a_window_is_made_again_if_its_depth_has_changed(
    young: float, twice: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    make = Backend._make
    monkeypatch.setattr(Backend, "_make", lambda self, k, *rest: (made.append(k), make(self, k, *rest)))
    b = run(list(room()[3]), monkeypatch, young=young)
    assert sorted(made) == sorted([0, 4, 8, 12, 16] * (2 if twice else 1))
    assert sorted(w.reference for w in b.windows) == [0, 4, 8, 12, 16]


def test_images_of_a_few_pixels_are_no_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "REACH", 2)
    scale = WorkingScale.of(ErpCamera(40, 20), 512)
    b = Backend(scale)
    for i in range(4):
        b.add(i, np.zeros((20, 40), np.float32))
    while (k := b.due(at_the_end=True)) is not None:
        b.adjust(k, lambda n: np.eye(4), np.ones((20, 40), np.float32))
    assert b.windows == []


def test_images_and_windows_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = list(room()[3])
    monkeypatch.setattr(backend, "LATE", 1)
    b = run(truth, monkeypatch, reach=3, every=2)
    assert sum(f.luma is not None for f in b.frames) <= (3 * 3 + 2 + 1 + 1) + (3 + 1)
    monkeypatch.setattr(backend, "FREE", 6)
    fit = b.fit(lambda i: truth[i], 2.0)
    assert len(b.windows) < 7
    assert min(fit.poses) > 0
    held = [i for i in fit.poses if i < FRAMES - 6]
    assert held
    assert fit.free == set(range(FRAMES - 6, FRAMES))
    for i in held:
        np.testing.assert_allclose(fit.poses[i], truth[i], atol=1e-12)


def test_frames_tracked_backwards_and_those_after_them_share_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "REACH", 8)
    monkeypatch.setattr(backend, "AGAIN", 16)
    monkeypatch.setattr(backend, "EVERY", 4)
    scale, luma, depth, T_wc = room()
    noise = np.random.default_rng(0).normal(0, 0.003, (FRAMES, 6))
    noise[10] = 0
    start = list(T_wc @ se3_exp(noise))
    b = Backend(scale)

    def adjust(at_the_end: bool) -> None:
        while (k := b.due(at_the_end=at_the_end)) is not None:
            index = b.frames[k].index
            b.adjust(k, lambda i: start[i], depth[index])

    for i in range(10, FRAMES):
        b.add(i, luma[i])
        adjust(at_the_end=i == FRAMES - 1)
    b.turn()
    for i in range(9, -1, -1):
        b.add(i, luma[i])
        adjust(at_the_end=i == 0)
    assert [f.index for f in b.frames] == list(range(FRAMES))[::-1]
    assert [b.frames[w.reference].index for w in b.windows] == [14, 18, 10, 6, 2]
    assert {b.frames[n].index for n in b.windows[2].frames} == set(range(2, 19)) - {10}
    fit = b.fit(lambda i: start[i], 2.0)
    after = np.stack([fit.poses[i] for i in range(FRAMES)])
    assert misfit(after, T_wc) < 0.4 * misfit(np.stack(start), T_wc)


def test_frames_without_a_window_follow() -> None:
    before = {i: se3_exp([0.1 * i, 0, 0, 0, 0.1 * i, 0]) for i in range(6)}
    turn = se3_exp([0.01, -0.02, 0.03, 0.02, 0.01, 0.0])
    fitted = {1: before[1], 3: turn @ before[3]}
    after, newest = followed(before, fitted)
    for i in (0, 1, 2):
        np.testing.assert_allclose(after[i], before[i], atol=1e-12)
    for i in (3, 4, 5):
        np.testing.assert_allclose(after[i], turn @ before[i], atol=1e-12)
    np.testing.assert_allclose(newest, turn, atol=1e-12)


def test_gaussians_look_the_same_from_the_keyframe_that_moved() -> None:
    before, after = se3_exp([1.0, 2.0, 3.0, 0.3, 0.2, 0.1]), se3_exp([1.1, 2.0, 2.9, 0.25, 0.2, 0.15])
    local = np.random.default_rng(1).normal(size=(5, 3))
    world = local @ before[:3, :3].T + before[:3, 3]
    g = GaussianMap(
        world.astype(np.float32), np.zeros((5, 3), np.float32), np.tile(np.float32([1, 0, 0, 0]), (5, 1)),
        np.zeros(5, np.float32), np.zeros((5, 3), np.float32),
    )  # fmt: skip
    move_gaussians(g, np.zeros(5, np.int64), [moved_by(before, after, 1.03)])
    np.testing.assert_allclose((g.means - after[:3, 3]) @ after[:3, :3], 1.03 * local, atol=1e-5)
    assert np.allclose(g.log_scales, np.log(1.03), atol=1e-6)
    assert np.abs(se3_log(before @ invert_pose(after))).max() > 0.01

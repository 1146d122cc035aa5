"""Loop factors from revisits: what ties the visits together, and what does not."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose, se3_exp, umeyama
from panobench.methods.panogs.config import FactorOptions, RevisitOptions
from panobench.methods.panogs.factor_graph.factors import FactorGraph
from panobench.methods.panogs.factor_graph.recognition import Way
from panobench.methods.panogs.factor_graph.revisits import RevisitFactors, _Reference, between, stretches
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric import pose_factors
from panobench.photometric.bundle import Bundle
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pose_factors import BundleFactor, marginalise
from panobench.photometric.pyramid import luma_of_frame
from panobench.photometric.stereo import WorkingScale

#: Frames of the sequence there and back; the way back is the second visit.
THERE = 18
ORDER = [*range(THERE), *range(THERE - 1, -1, -1)]


def back_and_forth(
    drift: float, old: int = 16, **options: float
) -> tuple[np.ndarray, AnchoredTrajectory, RevisitFactors]:
    """True poses, those a tracker with a drift of so much a frame would have found, and what was seen on the way."""
    sequence = RoomsDataset().open("tiny", width=128)
    assert sequence.groundtruth is not None
    scale = WorkingScale.of(sequence.camera, 128)
    first = invert_pose(sequence.groundtruth.T_wc[0])
    truth = np.stack([first @ sequence.groundtruth.T_wc[i] for i in ORDER])
    found = np.stack([se3_exp(np.array([1, 0.5, 0, 0, 0.3, 0]) * drift * k) @ T for k, T in enumerate(truth)])
    trajectory = AnchoredTrajectory()
    first_view = View(0, np.zeros((1, 1, 3), np.uint8), found[0])
    trajectory.add_keyframe(first_view, 0.0)
    for k in range(1, len(ORDER)):
        trajectory.add(k, k / 15, found[k], first_view)
    seen = RevisitFactors(scale, RevisitOptions(old=old, **options))
    graph = FactorGraph(scale, ViewWidth.WIDE, FactorOptions(reach=4, renew_after=8, every=2), seen)
    for k, i in enumerate(ORDER):
        graph.add(k, luma_of_frame(sequence.image(i), scale.valid))
        while (due := graph.due(at_end=k == len(ORDER) - 1)) is not None:
            depth = sequence.depth(ORDER[due])
            assert depth is not None
            graph.make_factor(due, trajectory, depth)
    return truth, trajectory, seen


def error(T: np.ndarray, truth: np.ndarray) -> float:
    s = umeyama(T[:, :3, 3], truth[:, :3, 3])
    return float(np.sqrt(((s.apply_points(T[:, :3, 3]) - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def test_coming_back_takes_out_the_drift() -> None:
    truth, trajectory, seen = back_and_forth(0.003)
    assert seen.revisits >= 3
    closed = seen.optimise(trajectory, 2.0).poses
    assert sorted(closed) == list(range(len(ORDER)))  # also those between references
    numbers = list(range(0, len(ORDER), 2))
    after = np.stack([closed[n] for n in numbers])
    assert error(after, truth[numbers]) < 0.2 * error(np.stack([trajectory[n] for n in numbers]), truth[numbers])
    np.testing.assert_allclose(closed[0], trajectory[0], atol=1e-12)


def test_a_place_is_recognised_by_its_look_wherever_the_poses_have_it() -> None:
    truth, trajectory, seen = back_and_forth(0.01, near=0.0, drift_max=1.0)
    assert seen.revisits >= 3
    assert seen.drifted
    before = np.stack([trajectory[k] for k in range(len(ORDER))])
    trajectory.correct(seen.optimise(trajectory, 2.0))
    assert not seen.drifted
    assert error(np.stack([trajectory[k] for k in range(len(ORDER))]), truth) < 0.2 * error(before, truth)


@pytest.mark.parametrize("option", [{"alike": 0}, {"drift_max": 0.0}, {"turn_max": 0.0}, {"agree": 1.0}])
def test_a_look_alike_that_a_check_refuses_changes_nothing(option: dict[str, float]) -> None:
    _, _, seen = back_and_forth(0.01, **{"near": 0.0, "drift_max": 1.0} | option)
    assert seen.revisits == 0
    assert not seen.drifted
    assert seen.way.ties == []


def test_ties_shorten_the_way() -> None:
    positions = np.stack([np.arange(10.0), np.zeros(10), np.zeros(10)], axis=1)
    positions[9] = [1.0, 2.0, 0.0]
    assert Way().lengths(positions)[1] == pytest.approx(7 + np.hypot(7, 2))
    tied = Way([(1, 8)]).lengths(positions)
    assert tied[1] == pytest.approx(7 + np.hypot(7, 2))  # the tie is as long as the places are apart so far
    assert Way([(1, 9)]).lengths(positions)[1] == pytest.approx(2.0)
    assert Way().lengths(np.zeros((3, 3))).max() < 1e-9


def test_frames_between_references_follow_them_at_their_scale() -> None:
    trajectory = AnchoredTrajectory()
    first = View(0, np.zeros((1, 1, 3), np.uint8), np.eye(4))
    trajectory.add_keyframe(first, 0.0)
    for k in range(1, 13):
        trajectory.add(k, float(k), se3_exp(np.array([0.1 * k, 0, 0, 0, 0, 0])), first)
    indices = [0, 4, 8]
    before = np.stack([trajectory[i] for i in indices])
    turn = se3_exp(np.array([0, 0, 0, 0, 0.5, 0]))
    after = turn @ np.stack([se3_exp(np.array([0.3 * i, 0, 0, 0, 0, 0])) for i in indices])
    fixed = between(trajectory, indices, before, after)
    for k in range(13):
        np.testing.assert_allclose(fixed.poses[k], turn @ se3_exp(np.array([0.3 * k, 0, 0, 0, 0, 0])), atol=1e-9)
    assert fixed.moves_world
    np.testing.assert_allclose(list(fixed.stretch.values()), 3.0)
    assert stretches(np.zeros((4, 3)), np.zeros((4, 3))).tolist() == [1.0] * 4


def test_many_poses_are_solved_for_as_few_are(monkeypatch: pytest.MonkeyPatch) -> None:
    _, trajectory, seen = back_and_forth(0.003)
    few = seen.optimise(trajectory, 2.0).poses
    monkeypatch.setattr(pose_factors, "MANY", 3)
    many = seen.optimise(trajectory, 2.0).poses
    for k in few:
        np.testing.assert_allclose(many[k], few[k], atol=1e-7)


def test_without_a_revisit_nothing_moves() -> None:
    _, trajectory, seen = back_and_forth(0.003, old=1000)
    assert seen.revisits == 0
    assert seen.optimise(trajectory, 2.0).poses == {}


def test_another_place_that_is_taken_for_this_one_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The poses say the camera is back, the images show something else."""
    rng = np.random.default_rng(0)
    whole = RevisitFactors._pyramid

    def other(self: RevisitFactors, place: _Reference) -> list:
        if self.references[-1].number - place.number >= 16:
            noise = np.kron(rng.integers(0, 255, place.luma.shape, np.uint8)[::8, ::8], np.ones((8, 8), np.uint8))
            place = _Reference(place.number, place.index, noise[: place.luma.shape[0], : place.luma.shape[1]])
        return whole(self, place)

    monkeypatch.setattr(RevisitFactors, "_pyramid", other)
    _, _, seen = back_and_forth(0.0)
    assert seen.revisits == 0


def test_a_marginalised_factor_costs_what_the_whole_costs_at_best() -> None:
    rng = np.random.default_rng(1)
    F = 3
    root = rng.normal(size=(6 * F, 6 * F))
    H, g = root @ root.T, rng.normal(size=6 * F)
    factor = BundleFactor(0, np.array([2, 4, 5]), Bundle(np.tile(np.eye(4), (F, 1, 1)), 1.0, H, g))
    keep = np.array([True, False, True])
    small = marginalise(factor, keep)
    assert small is not None
    assert small.frames.tolist() == [2, 5]
    kept = np.repeat(keep, 6)
    x = rng.normal(size=12)
    best = np.linalg.solve(H[np.ix_(~kept, ~kept)], -g[~kept] - H[np.ix_(~kept, kept)] @ x)
    full = np.zeros(18)
    full[kept], full[~kept] = x, best
    gradient = (H @ full + g)[kept]  # by the kept, where the others are at their best
    np.testing.assert_allclose(small.bundle.information @ x + small.bundle.gradient, gradient, rtol=1e-6, atol=1e-8)
    assert marginalise(factor, np.zeros(F, bool)) is None
    whole = marginalise(factor, np.ones(F, bool))
    assert whole is not None
    np.testing.assert_allclose(whole.bundle.information, H)

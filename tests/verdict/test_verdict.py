"""The verdict on runs: right ones are trusted, each kind of fault is named, and doubts add up."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import Sim3, se3_exp, so3_exp
from panobench.types import DepthEstimate, Estimate, Trajectory
from panobench.verdict.assess import BACKWARDS, assess
from panobench.verdict.base import Evidence, Word, decide, falling
from panobench.verdict.trajectory import coverage, path_deviation, second_method, steadiness


def walk(count: int = 60, noise: float = 0.0, seed: int = 0) -> Trajectory:
    """A curved walk of about 2 m, at 15 Hz."""
    t = np.arange(count) / 15
    T = np.stack([se3_exp([0.0, 0.0, 0.0, 0.0, 0.3 * s, 0.0]) for s in t])
    T[:, :3, 3] = np.stack([0.5 * t, 0.05 * np.sin(6 * t), 0.2 * t**1.5], axis=1)
    T[:, :3, 3] += noise * np.random.default_rng(seed).normal(size=(count, 3))
    return Trajectory(t, T)


def depth(ok: bool) -> DepthEstimate:
    return DepthEstimate(np.ones((4, 8), np.float32), ok=ok, message="" if ok else "constant depth")


def test_a_run_with_nothing_against_it_is_trusted() -> None:
    verdict = assess(
        Estimate(walk(), depth=depth(True)), 60, {"pano_psnr_db": 28.0}, {"sparse": Estimate(walk(noise=0.001))}
    )
    assert verdict.word is Word.TRUSTED
    assert verdict.confidence == pytest.approx(1.0)
    assert verdict.reasons == ()
    assert len(verdict.evidence) == 5


def test_a_path_that_a_second_method_contradicts_is_doubtful_and_says_so() -> None:
    other = walk()
    bent = other.T_wc.copy()
    bent[:, 0, 3] += 0.15 * other.times**2
    verdict = assess(Estimate(walk()), 60, others={"sparse": Estimate(Trajectory(other.times, bent))})
    assert verdict.word is not Word.TRUSTED
    assert "'sparse'" in verdict.reasons[0]
    assert verdict.advice


def test_a_second_method_whose_features_do_not_fit_its_path_only_fails_to_confirm() -> None:
    bent = walk().T_wc.copy()
    bent[:, 0, 3] += 0.4 * walk().times ** 2
    rows = {i: {"error_px": 1.4} for i in range(60)}
    for frames, word in (({}, Word.FAILED), (rows, Word.DOUBTFUL)):
        other = Estimate(Trajectory(walk().times, bent), frames=frames)
        verdict = assess(Estimate(walk()), 60, others={"sparse": other})
        assert verdict.word is word
    assert "do not fit" in verdict.reasons[0]
    assert assess(Estimate(walk()), 60, others={"sparse": Estimate(walk(), frames=rows)}).word is Word.TRUSTED


def test_pixels_of_an_enlarged_recording_are_counted_as_they_were_recorded() -> None:
    def judged(error_px: float, enlargement: float, width: int = 512) -> Word:
        rows = {i: {"error_px": error_px} for i in range(60)}
        run = Estimate(walk(), frames=rows, extra={"pixels_per_radian": width / (2 * np.pi)})
        return assess(run, 60, enlargement=enlargement).word

    assert judged(1.4, 1.0) is Word.DOUBTFUL
    assert judged(1.4, 2.0) is Word.TRUSTED  # 0.7 pixels of a video of 256
    assert judged(2.8, 2.0) is Word.DOUBTFUL
    assert judged(2.8, 2.0, width=2048) is Word.TRUSTED  # a fine image, enlarged or not, has more pixels to be off by
    assert judged(2.8, 1.0, width=2048) is Word.TRUSTED


def test_the_second_methods_world_and_scale_do_not_matter() -> None:
    other = walk(noise=0.0005, seed=1)
    moved = Sim3(3.0, so3_exp(np.array([0.1, 2.0, 0.3])), np.array([1.0, 2.0, 3.0])).apply_poses(other.T_wc)
    evidence = second_method(walk(), Trajectory(other.times, moved), "sparse", 60)
    assert evidence is not None
    assert evidence.trust == 1.0


def test_a_second_method_that_lost_its_way_confirms_nothing() -> None:
    verdict = assess(Estimate(walk()), 60, others={"sparse": Estimate(walk().select(np.arange(5)))})
    assert verdict.word is Word.DOUBTFUL
    assert "5 of 60 frames" in verdict.reasons[0]
    assert assess(Estimate(walk()), 60, others={"sparse": Estimate(walk().select(np.arange(0)))}).word is Word.DOUBTFUL
    assert second_method(walk().select(np.arange(5)), walk(), "sparse", 60) is None  # this one did


def test_a_camera_that_stands_still_cannot_be_compared() -> None:
    still = Trajectory(walk().times, np.tile(np.eye(4), (60, 1, 1)))
    assert second_method(walk(), still, "sparse", 60) is None
    assert path_deviation(walk().positions, still.positions) is None


def test_frames_without_a_pose_count() -> None:
    assert coverage(60, 60).trust == 1.0
    assert coverage(58, 60).trust > 0.5
    assert coverage(0, 0).trust < 0.05
    assert assess(Estimate(walk(50)), 60).word is Word.FAILED


def test_a_jump_is_named_with_its_time() -> None:
    T = walk().T_wc.copy()
    T[30:, :3, 3] += [0.0, 0.8, 0.0]
    evidence = steadiness(Trajectory(walk().times, T))
    assert evidence.trust < 0.5
    assert "2.00 s" in evidence.text
    assert steadiness(walk()).trust == 1.0


def test_a_jump_that_a_second_method_has_too_is_in_the_recording() -> None:
    T = walk().T_wc.copy()
    T[30:, :3, 3] += [0.0, 0.8, 0.0]
    jumps, moved = Trajectory(walk().times, T), Sim3(2.0, so3_exp(np.array([0.0, 1.0, 0.0])), np.ones(3))
    same = Trajectory(walk().times, moved.apply_poses(T))
    assert assess(Estimate(jumps), 60).word is not Word.TRUSTED
    assert assess(Estimate(jumps), 60, others={"sparse": Estimate(same)}).word is Word.TRUSTED
    assert steadiness(jumps, [walk()]).trust < 0.5
    assert steadiness(jumps, [same.select(np.r_[0:20, 40:60])]).trust < 0.5  # it did not see it


def test_a_frame_beside_the_path_is_named_with_its_time() -> None:
    T = walk().T_wc.copy()
    usual = float(np.linalg.norm(np.diff(walk().positions, axis=0), axis=1).max())
    T[30, :3, 3] += [0.0, 2.5 * usual, 0.0]
    evidence = steadiness(Trajectory(walk().times, T))
    assert evidence.trust < 0.5
    assert "beside the path at 2.00 s" in evidence.text


def test_turning_back_is_not_beside_the_path() -> None:
    there = walk(30).T_wc
    assert steadiness(Trajectory(np.arange(60) / 15, np.concatenate([there, there[::-1]]))).trust == 1.0
    zigzag = np.concatenate([walk(2).T_wc] * 30)
    assert steadiness(Trajectory(np.arange(60) / 15, zigzag)).trust == 1.0


def test_noise_of_a_slow_camera_is_not_beside_the_path() -> None:
    rng = np.random.default_rng(0)
    for speed in (0.0, 1e-4, 1e-3):
        T = np.tile(np.eye(4), (3000, 1, 1))
        T[:, 0, 3] = speed * np.arange(3000)
        T[:, :3, 3] += rng.normal(0, 1e-3, (3000, 3))
        assert steadiness(Trajectory(np.arange(3000) / 60, T)).trust == 1.0


def test_standing_still_and_starting_to_walk_is_no_jump() -> None:
    still = np.tile(np.eye(4), (40, 1, 1))
    going = walk(40).T_wc
    both = np.concatenate([still, going])
    both[:, :3, 3] += np.random.default_rng(0).normal(0, 1e-4, (80, 3))
    assert steadiness(Trajectory(np.arange(80) / 15, both)).trust == 1.0


def test_a_constant_start_and_a_blurred_map_are_doubts_that_add_up() -> None:
    constant = assess(Estimate(walk(), depth=depth(False)), 60)
    both = assess(Estimate(walk(), depth=depth(False)), 60, {"pano_psnr_db": 16.0})
    assert constant.word is Word.DOUBTFUL
    assert both.confidence < constant.confidence
    assert "constant depth" in constant.reasons[0]


def test_a_failed_start_matters_less_where_a_second_method_confirms_the_path() -> None:
    alone = assess(Estimate(walk(), depth=depth(False)), 60)
    confirmed = assess(Estimate(walk(), depth=depth(False)), 60, others={"sparse": Estimate(walk(noise=0.0005))})
    assert alone.word is Word.DOUBTFUL
    assert confirmed.word is Word.TRUSTED
    assert "failed its check" in confirmed.reasons[0]


def test_what_moves_is_missing_in_the_maps_pictures() -> None:
    still, moving = (assess(Estimate(walk(), extra={"moving": m}), 60, {"pano_psnr_db": 15.0}) for m in (False, True))
    assert still.word is Word.DOUBTFUL
    assert moving.word is Word.TRUSTED


def test_pictures_that_differ_in_brightness_alone_are_a_small_doubt() -> None:
    """As where a recording fades in: blocks correlate although the map is far darker."""
    for share, word in ((0.9, Word.TRUSTED), (0.6, Word.FAILED)):
        estimate = Estimate(walk(), frames={i: {"agreement": share} for i in range(0, 60, 5)})
        assert assess(estimate, 60, {"pano_psnr_db": 10.0}).word is word


def test_what_the_map_does_not_explain_counts() -> None:
    rows = {i: {"agreement": 0.3 if i % 3 == 0 else 0.9} for i in range(30)}
    assert assess(Estimate(walk(), frames=rows), 60).word is not Word.TRUSTED
    assert assess(Estimate(walk(), frames={i: {"agreement": 0.9} for i in range(30)}), 60).word is Word.TRUSTED


def test_features_that_do_not_fit_one_scene_are_a_doubt() -> None:
    """A quarter of the frames may be bad: a glance at the hand."""
    for usual, bad, word in ((0.5, 1.5, Word.TRUSTED), (1.2, 1.2, Word.DOUBTFUL)):
        rows = {i: {"error_px": bad if i % 4 == 0 else usual} for i in range(40)}
        verdict = assess(Estimate(walk(), frames=rows), 60)
        assert verdict.word is word
    assert "1.2 pixels" in verdict.reasons[0]


def test_a_view_that_mostly_does_not_move_as_a_rigid_scene_is_a_doubt_whoever_agrees() -> None:
    verdict = assess(Estimate(walk()), 60, others={"sparse": Estimate(walk())}, not_rigid=0.86)
    assert verdict.word is Word.DOUBTFUL
    assert "86%" in verdict.reasons[0]


def test_an_imu_that_contradicts_the_camera_is_a_doubt_and_one_that_agrees_or_is_no_help_is_none() -> None:
    wrong = {"initialised": False, "contradicted": True, "reason": "the IMU contradicts the camera: degrees/s"}
    verdict = assess(Estimate(walk(), extra={"inertial": wrong}), 60)
    assert verdict.word is Word.DOUBTFUL
    assert "degrees/s" in verdict.reasons[0]
    assert "--imu off" in verdict.advice[0]
    for fine in ({"initialised": True}, {"initialised": False, "contradicted": False, "reason": "it stood still"}, {}):
        assert assess(Estimate(walk(), extra={"inertial": fine}), 60).word is Word.TRUSTED


def test_a_path_that_hangs_together_by_looks_alone_is_a_doubt() -> None:
    verdict = assess(Estimate(walk(), extra={"maps": 1, "joined": 1, "joined_by_looks": 1}), 60)
    assert verdict.word is Word.DOUBTFUL
    assert "after a cut" in verdict.reasons[0]
    assert assess(Estimate(walk(), extra={"maps": 1, "joined": 1, "joined_by_looks": 0}), 60).word is Word.TRUSTED


@pytest.mark.parametrize(
    ("said", "word"),
    [
        ({"maps": 1, "relocalised": 0}, Word.TRUSTED),
        ({"maps": 1, "relocalised": 1}, Word.DOUBTFUL),  # by looks, too
        ({"maps": 2, "relocalised": 0}, Word.DOUBTFUL),
        ({}, Word.DOUBTFUL),
    ],
)
def test_it_is_none_where_another_method_has_followed_the_camera(said: dict[str, int], word: Word) -> None:
    joined = Estimate(walk(), extra={"maps": 1, "joined": 1, "joined_by_looks": 1})
    assert assess(joined, 60, others={"sparse": Estimate(walk(noise=0.0005), extra=dict(said))}).word is word
    bent = walk().T_wc.copy()
    bent[:, 0, 3] += 0.15 * walk().times ** 2
    other = Estimate(Trajectory(walk().times, bent), extra=dict(said))
    assert assess(joined, 60, others={"sparse": other}).word is not Word.TRUSTED


def test_where_a_run_doubts_itself_a_method_that_does_not_is_advised() -> None:
    lost = Estimate(Trajectory(walk().times[:20], walk().T_wc[:20]))
    asked = {"sparse": Estimate(walk(), frames={i: {"error_px": 0.3} for i in range(60)})}
    assert "--method sparse" in assess(lost, 60, others=asked).advice[0]
    assert "--method" not in assess(lost, 60, others={BACKWARDS: asked["sparse"]}).advice[0]
    assert "--method" not in assess(lost, 60, others=asked, not_rigid=0.8).advice[0]
    assert assess(Estimate(walk()), 60, others=asked).advice == ()
    doubted = {"sparse": Estimate(walk(), frames={i: {"error_px": 1.4} for i in range(60)})}
    assert "--method" not in assess(lost, 60, others=doubted).advice[0]


def test_a_run_that_does_not_count_has_failed() -> None:
    verdict = assess(Estimate(walk()), 60, rejected="crashed: no memory")
    assert verdict.word is Word.FAILED
    assert verdict.confidence == 0.0
    assert verdict.reasons[0] == "crashed: no memory"


def test_trust_falls_from_good_to_bad_in_either_direction() -> None:
    assert falling(0.001, 0.005, 0.02) == 1.0
    assert falling(0.02, 0.005, 0.02) == pytest.approx(0.1)
    assert falling(13.0, 19.0, 13.0) == pytest.approx(0.1)
    assert falling(30.0, 19.0, 13.0) == 1.0
    assert falling(float("nan"), 1.0, 2.0) < 0.1
    with pytest.raises(ValueError, match="trust"):
        Evidence("x", 1.5, "")


def test_the_worst_reason_comes_first() -> None:
    verdict = decide([Evidence("a", 0.9, "a little"), Evidence("b", 0.2, "a lot"), Evidence("c", 1.0, "nothing")])
    assert verdict.reasons == ("a lot", "a little")

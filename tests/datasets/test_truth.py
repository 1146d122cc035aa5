"""Ground truth that is not stamped as the frames."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.bench.run.views import ChosenFrames
from panobench.datasets.files.truth import MAX_GAP_S, truth_at_frames
from panobench.geometry import make_pose, so3_exp, so3_log
from panobench.testing import TinySequence
from panobench.types import Trajectory

FRAMES = np.arange(24) / 15


def motion(t: np.ndarray) -> Trajectory:
    """A smooth path that is known at every time."""
    t = np.asarray(t, dtype=float)
    R = so3_exp(np.stack([0.3 * np.sin(t), 0.8 * t, 0.1 * t**2], axis=1))
    return Trajectory(t, make_pose(R, np.stack([np.sin(t), 0.5 * t, np.cos(2 * t)], axis=1)))


def check(found: Trajectory | None, times: np.ndarray, within_m: float = 2e-3) -> None:
    assert found is not None
    np.testing.assert_array_equal(found.times, times)
    exact = motion(times)
    assert np.abs(found.positions - exact.positions).max() < within_m
    angle = np.linalg.norm(so3_log(np.swapaxes(found.T_wc[:, :3, :3], 1, 2) @ exact.T_wc[:, :3, :3]), axis=1)
    assert angle.max() < within_m


@pytest.mark.parametrize(("rate", "late"), [(100, 0.0), (100, 0.004), (99.7, 0.0003), (1000, 0.0), (10, 0.03)])
def test_truth_of_another_rate_is_interpolated(rate: float, late: float) -> None:
    recorded = motion(np.arange(-1, 3, 1 / rate) + late)
    check(truth_at_frames(recorded, FRAMES), FRAMES, 6e-3 if rate == 10 else 2e-4)


def test_rows_made_for_the_frames_are_taken_as_they_are() -> None:
    recorded = motion(FRAMES)
    rounded = Trajectory(np.round(FRAMES, 3), recorded.T_wc)  # a time with three digits means the frame
    found = truth_at_frames(rounded, FRAMES)
    assert found is not None
    np.testing.assert_array_equal(found.T_wc, recorded.T_wc)
    few = truth_at_frames(rounded.select(np.arange(0, 24, 5)), FRAMES)
    assert few is not None
    np.testing.assert_allclose(few.T_wc, recorded.T_wc[::5], atol=1e-12)


def test_gaps_and_ends_are_not_bridged() -> None:
    t = np.arange(0.2, 1.2, 0.01)
    recorded = motion(t[(t < 0.5) | (t > 0.5 + MAX_GAP_S)])
    found = truth_at_frames(recorded, FRAMES)
    inside = (FRAMES >= 0.2) & (FRAMES <= 1.19) & ~((FRAMES > 0.49) & (FRAMES < 0.63))
    check(found, FRAMES[inside])
    assert truth_at_frames(motion(np.arange(5) + 1000.0), FRAMES) is None
    assert truth_at_frames(motion(np.zeros(0)), FRAMES) is None


class Recorded(TinySequence):
    """Frames with a truth of their own clock."""

    def __init__(self, recorded: Trajectory) -> None:
        super().__init__(n=12)
        self._recorded = recorded

    @property
    def recorded_truth(self) -> Trajectory:
        return self._recorded

    @property
    def groundtruth(self) -> Trajectory | None:
        return truth_at_frames(self._recorded, self.times)


def test_how_many_frames_have_truth_is_said_and_why_not_more() -> None:
    times = TinySequence(n=12).times
    assert ChosenFrames(Recorded(motion(times))).remarks() == []
    assert ChosenFrames(TinySequence(n=12)).remarks() == []
    [most] = ChosenFrames(Recorded(motion(times[:11]))).remarks()
    assert most == "ground truth for 11 of 12 frames"
    [half] = ChosenFrames(Recorded(motion(np.arange(0, 9, 2 * MAX_GAP_S)))).remarks()
    assert f"gaps over {MAX_GAP_S:g} s are not bridged" in half
    [none] = ChosenFrames(Recorded(motion(times + 1000))).remarks()
    assert none.startswith("ground truth for 0 of 12 frames: it spans 1000.000 to")
    assert f"the frames 0.000 to {times[-1]:.3f} s" in none
    assert "--align-time" in none
    [some] = ChosenFrames(Recorded(motion(times[:6])), every=2).remarks()
    assert some.startswith("ground truth for 3 of 6 frames")

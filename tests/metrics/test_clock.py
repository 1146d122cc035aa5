"""The offset between two clocks, from motion seen by both."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import Sim3, make_pose, so3_exp
from panobench.metrics.clock import find_offset
from panobench.types import Trajectory


def walk(t: np.ndarray) -> np.ndarray:
    """Poses (N, 4, 4) of somebody who walks and looks about."""
    t = np.asarray(t, dtype=float)
    turn = np.stack([0.1 * np.sin(3.1 * t), 0.6 * np.sin(0.9 * t) + 0.2 * t, 0.05 * np.cos(2.3 * t)], axis=1)
    place = np.stack([np.sin(0.7 * t) * 2, 0.05 * np.sin(11 * t), 0.8 * t + 0.3 * np.cos(1.7 * t)], axis=1)
    return make_pose(so3_exp(turn), place)


def estimate(t: np.ndarray, noise: float = 0.002) -> Trajectory:
    """What a monocular method finds: another world and scale, and noise."""
    moved = Sim3(0.3, so3_exp([0.4, -1.0, 0.2]), np.array([1.0, 2.0, 3.0])).apply_poses(walk(t))
    moved[:, :3, 3] += np.random.default_rng(0).normal(0, 0.3 * noise, (len(t), 3))
    return Trajectory(t, moved)


@pytest.mark.parametrize("offset", [0.0, 0.0173, -0.5, 12.3, -1.5e9])
@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_an_offset_is_found_from_the_motion(offset: float, rate: float) -> None:
    frames = np.arange(200) / 15
    truth = np.arange(-2, 16, 1 / rate)
    found = find_offset(estimate(frames), Trajectory(truth - offset, walk(truth)), 0.12)
    assert found is not None
    assert found.offset_s == pytest.approx(offset, abs=3e-3)
    assert found.cost < 0.02
    assert found.within_s < 0.2


def test_truth_of_a_part_of_the_frames(tmp_path: object) -> None:
    frames = np.arange(300) / 15
    truth = np.arange(6, 14, 0.02)
    found = find_offset(estimate(frames), Trajectory(truth + 100, walk(truth)), 0.12)
    assert found is not None
    assert found.offset_s == pytest.approx(-100, abs=5e-3)


def test_no_offset_is_found_where_the_motions_have_nothing_in_common() -> None:
    frames = np.arange(150) / 15
    rng = np.random.default_rng(3)
    steps = np.cumsum(rng.normal(size=(300, 3)), axis=0)
    other = make_pose(so3_exp(np.cumsum(0.2 * rng.normal(size=(300, 3)), axis=0)), steps)
    assert find_offset(estimate(frames), Trajectory(np.arange(300) * 0.05, other), 0.12) is None
    assert find_offset(estimate(frames[:5]), Trajectory(frames, walk(frames)), 0.12) is None
    still = np.tile(np.eye(4), (100, 1, 1))
    assert find_offset(estimate(frames), Trajectory(np.arange(100) * 0.05, still), 0.12) is None


def test_a_steady_motion_tells_that_it_does_not_tell() -> None:
    frames = np.arange(150) / 15
    steady = make_pose(np.eye(3), np.stack([frames, 0 * frames, 0 * frames], axis=1))
    longer = np.arange(-5, 20, 0.05)
    truth = Trajectory(longer, make_pose(np.eye(3), np.stack([longer, 0 * longer, 0 * longer], axis=1)))
    found = find_offset(Trajectory(frames, steady), truth, 0.12)
    assert found is None or found.within_s > 1

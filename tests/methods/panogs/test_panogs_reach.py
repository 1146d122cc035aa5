"""Where the camera can have come to since its last pose."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import make_pose, so3_exp
from panobench.methods.panogs.tracking.reach import Reach

AT_ONCE = make_pose(np.eye(3), [0.1, 0.0, 0.0])


def walked(step: float) -> Reach:
    reach = Reach(5)
    for _ in range(8):
        reach.record(np.eye(4), make_pose(np.eye(3), [2 * step, 0.0, 0.0]), 2)
    return reach


def test_a_jump_is_out_of_reach_until_the_camera_was_lost_for_long() -> None:
    reach, far = walked(0.1), make_pose(so3_exp([0.0, 3.0, 0.0]), [3.8, 0.0, 0.0])
    assert reach.allows(np.eye(4), AT_ONCE, 1, depth=1.5)
    assert not reach.allows(np.eye(4), far, 1, depth=1.5)
    assert reach.allows(np.eye(4), far, 10, depth=1.5)


def test_a_camera_that_stood_may_move() -> None:
    assert walked(0.0).allows(np.eye(4), make_pose(np.eye(3), [0.7, 0.0, 0.0]), 1, depth=1.5)
    assert not walked(0.0).allows(np.eye(4), make_pose(np.eye(3), [0.8, 0.0, 0.0]), 1, depth=1.5)


def test_nothing_is_out_of_reach_before_the_camera_has_moved() -> None:
    assert Reach(5).allows(np.eye(4), make_pose(np.eye(3), [50.0, 0.0, 0.0]), 1, depth=1.5)


@pytest.mark.parametrize(("degrees", "allowed"), [(3.0, True), (8.0, False), (178.0, False)])
def test_a_turn_that_the_gyroscope_did_not_see_is_refused(degrees: float, allowed: bool) -> None:
    expected = make_pose(so3_exp([0.0, 0.0, 1.0]), [9.0, 9.0, 9.0])
    found = make_pose(so3_exp([0.0, 0.0, 1.0]) @ so3_exp([0.0, np.radians(degrees), 0.0]), [0.1, 0.0, 0.0])
    assert walked(0.1).allows(np.eye(4), found, 1, depth=1.5, expected=expected) is allowed

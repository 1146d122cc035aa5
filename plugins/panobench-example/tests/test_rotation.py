"""The example method keeps the contract and finds the rotation of an exact synthetic sequence."""

from __future__ import annotations

import numpy as np
from panobench_example import ROTATION
from panobench_example.rotation import Rotation, RotationConfig

from panobench.testing import TinySequence, assert_conforms, rotating_pose, rotation_error_deg, run_method


def test_it_keeps_the_contract() -> None:
    assert_conforms(ROTATION)


def test_pure_rotation_is_found() -> None:
    sequence = TinySequence(n=12, pose=rotating_pose)
    run = run_method(Rotation(), sequence)
    assert len(run.estimate.trajectory) == 12
    assert rotation_error_deg(run, sequence) < 1.0


def test_a_fast_turn_is_found() -> None:
    sequence = TinySequence(n=6, rate=1.0, pose=rotating_pose)  # 34 degrees of yaw per frame
    assert rotation_error_deg(run_method(Rotation(), sequence), sequence) < 1.0


def test_translation_changes_little() -> None:
    sequence = TinySequence(n=8)
    run = run_method(Rotation(RotationConfig(iterations=2)), sequence)
    assert rotation_error_deg(run, sequence) < 1.5
    assert np.array_equal(run.estimate.trajectory.positions, np.zeros((8, 3)))

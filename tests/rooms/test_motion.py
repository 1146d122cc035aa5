"""Camera paths: clear of everything, smooth, and novel views away from them."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.geometry import so3_log
from panobench.rooms import motion, walks
from panobench.rooms.kinds import KINDS
from panobench.rooms.trace import clearances


@pytest.mark.parametrize("kind", ["tiny", "room3"])
def test_a_path_keeps_clear_and_turns_slowly(kind: str) -> None:
    plan = KINDS[kind].plan(np.random.default_rng(4))
    how, mesh = KINDS[kind].motion, plan.mesh
    T_wc = motion.clear_trajectory(plan.walk, how, 100, mesh, np.random.default_rng(5), 0.3)
    assert T_wc.shape == (100, 4, 4)
    assert clearances(mesh.p0, mesh.eu, mesh.ev, np.ascontiguousarray(T_wc[:, :3, 3])).min() >= 0.3
    step = np.linalg.norm(np.diff(T_wc[:, :3, 3], axis=0), axis=1)
    assert step.max() < 1.6 * how.step
    R = T_wc[:, :3, :3]
    turned = np.degrees(np.linalg.norm(so3_log(np.swapaxes(R[:-1], 1, 2) @ R[1:]), axis=-1))
    assert turned.max() < 7
    novel = motion.novel_poses(T_wc, mesh, np.random.default_rng(6), 5, 0.3)
    away = np.linalg.norm(novel[:, None, :3, 3] - T_wc[:, :3, 3], axis=-1).min(axis=1)
    assert ((away >= 0.1) & (away <= 0.45)).all()


def test_yaw_pitch_and_roll() -> None:
    R = motion.rotations(np.array([0.0, np.pi / 2, 0.0]), np.array([0.0, 0.0, np.pi / 6]), np.zeros(3))
    np.testing.assert_allclose(R[0][:, 2], (1, 0, 0), atol=1e-12)  # forward along +x
    np.testing.assert_allclose(R[1][:, 2], (0, 1, 0), atol=1e-12)  # positive yaw: to the left
    assert R[2][2, 2] == pytest.approx(0.5)  # positive pitch: up
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    leaning = motion.rotations(np.zeros(1), np.zeros(1), np.array([0.2]))[0]
    assert leaning[2, 0] < 0  # the camera's right side points down


def test_a_head_is_carried_along_a_path_looks_ahead_and_sways_in_its_own_axes() -> None:
    x = np.linspace(0.0, 3.0, 40)
    place = np.stack([x, 2 * x, np.full(40, 1.6)], axis=1)
    course, still = np.tile([1.0, 2.0, 0.0], (40, 1)), np.zeros(40)
    up, aside, forward = 0.03 * np.sin(5 * x), 0.02 * np.cos(3 * x), 0.01 * np.sin(x)
    plain = walks.on_the_head(place, course, 4.0, [], still, still, walks.Sway(still, still))
    assert np.allclose(plain[:, :3, 3], place, atol=0)
    assert np.allclose(plain[:, :3, 2], [1 / 5**0.5, 2 / 5**0.5, 0.0]), "z looks where the walk goes"
    assert np.allclose(plain[:, :3, 1], [0.0, 0.0, -1.0]), "y points down"
    swaying = walks.on_the_head(
        place, course, 4.0, [still + 0.5, still - 0.2], still, still, walks.Sway(up, aside, forward)
    )
    moved = np.einsum("nji,nj->ni", plain[:, :3, :3], swaying[:, :3, 3] - place)
    assert np.allclose(moved, np.stack([aside, -up, forward], axis=1))
    turn = so3_log(np.swapaxes(plain[:, :3, :3], 1, 2) @ swaying[:, :3, :3])
    assert np.allclose(np.abs(turn), [0.0, 0.3, 0.0])

"""Row times of a rolling shutter, and angular velocities along poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.rig import Rig
from panobench.cameras.rig_panorama import RigPanorama
from panobench.cameras.row_times import rates_along, rig_row_times, rotated, row_times
from panobench.geometry import make_pose, so3_exp
from panobench.testing import two_lenses

T = np.cumsum([0.0, 0.1, 0.05, 0.1, 0.2])


def test_rates_along_poses_are_those_of_a_steady_acceleration_also_between_uneven_times() -> None:
    poses = np.stack([make_pose(so3_exp(np.array([0.0, 0.0, 2.0 * s * s])), np.zeros(3)) for s in T])
    np.testing.assert_allclose(rates_along(T, poses)[:, 2], 4.0 * T, atol=1e-6)
    np.testing.assert_allclose(rates_along(T[:2], poses[:2])[:, 2], [0.2, 0.2], atol=1e-6)
    assert not rates_along(T[:1], poses[:1]).any()


def test_rotated_is_the_exponential_of_the_rate() -> None:
    rng = np.random.default_rng(0)
    rays, seconds, rate = rng.normal(size=(20, 3)), rng.uniform(-1, 1, 20), np.array([0.3, -1.0, 0.5])
    expected = np.einsum("nij,nj->ni", so3_exp(seconds[:, None] * rate), rays)
    np.testing.assert_allclose(rotated(rays, seconds, rate), expected, atol=1e-12)
    np.testing.assert_allclose(rotated(rays, seconds, np.tile(rate, (20, 1))), expected, atol=1e-12)
    np.testing.assert_allclose(rotated(rays, seconds, np.zeros(3)), rays)


def test_rows_of_a_panorama_run_down_both_lenses_and_those_of_other_cameras_are_their_own() -> None:
    rays = ErpCamera(64, 32).rays()
    rows = row_times(ErpCamera(64, 32), rays)
    assert (np.diff(rows, axis=0) > 0).all()
    assert np.abs(rows).max() <= 0.5
    np.testing.assert_allclose(rows[:, :32], rows[:, 32:], atol=1e-9)
    camera = PinholeCamera.from_fov(40, 30, 80)
    own = row_times(camera, camera.rays())
    assert own[0, 0] == pytest.approx(0.5 / camera.height - 0.5)
    assert own[-1, -1] == pytest.approx(0.5 - 0.5 / camera.height)


def test_rows_of_a_rig_are_those_of_the_lens_that_sees() -> None:
    rig = two_lenses(96)
    turned = replace(
        rig.lenses[1], T_rig_lens=rig.lenses[1].T_rig_lens @ make_pose(so3_exp([0, 0, np.pi]), np.zeros(3))
    )
    rig = Rig((replace(rig.lenses[0], readout_s=0.02), replace(turned, readout_s=0.01)))
    up = np.array([[0.0, -0.6, 0.8], [0.0, -0.6, -0.8], [0.0, 0.0, 1.0]])
    rows = rig_row_times(rig, up)
    assert rig.readout_s == 0.02
    assert -0.5 < rows[0] < -0.1  # the upper rows come first
    assert rows[1] == pytest.approx(-0.5 * rows[0], rel=1e-6)  # upside down, and in half the time
    assert rows[2] == pytest.approx(0, abs=0.01)
    plain = ErpCamera(64, 32)
    whole = rig_row_times(two_lenses(96), plain.rays().reshape(-1, 3)).reshape(32, 64)
    np.testing.assert_allclose(whole, row_times(plain, plain.rays()), atol=0.02)
    assert two_lenses(96).readout_s is None
    panorama = RigPanorama.of(rig, plain)
    np.testing.assert_array_equal(
        row_times(panorama, plain.rays()).ravel(), rig_row_times(rig, plain.rays().reshape(-1, 3))
    )

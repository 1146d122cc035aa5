"""Where the camera is between frames, and how two lenses become a panorama."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.row_times import row_times
from panobench.capture.lenses import STITCHED_AT, gains, lens_weights, lenses
from panobench.capture.motion import Ride, levelling
from panobench.geometry import make_pose, se3_exp, so3_exp

CAMERA = ErpCamera(128, 64)
TIMES = np.arange(12) / 15
POSES = np.stack([se3_exp([0.05 * i, 0.01 * i * i, 0, 0.02 * i, 0.04 * i, 0.01]) for i in range(12)])


def test_a_ride_goes_through_the_poses_and_is_smooth() -> None:
    ride = Ride(TIMES, POSES)
    assert np.allclose([ride.pose(t) for t in TIMES], POSES, atol=1e-9)
    between = ride.pose(float(TIMES[4] + 0.01))
    assert 0 < np.linalg.norm(between[:3, 3] - POSES[4, :3, 3]) < np.linalg.norm(POSES[5, :3, 3] - POSES[4, :3, 3])


def test_a_swing_reaches_its_rate_about_the_vertical() -> None:
    still = np.repeat(np.eye(4)[None], 12, axis=0)
    ride = Ride(np.linspace(0, 4, 12), still, turn=200)
    rates = np.array([ride.rate(t) for t in np.linspace(0.1, 3.9, 200)])
    assert np.degrees(np.abs(rates[:, 1]).max()) == pytest.approx(200, rel=0.01)
    assert np.abs(rates[:, [0, 2]]).max() < 1e-6


def test_a_gait_sways_in_centimetres_and_degrees() -> None:
    still = np.repeat(np.eye(4)[None], 12, axis=0)
    ride = Ride(np.linspace(0, 4, 12), still, gait=1.0)
    T = np.stack([ride.pose(t) for t in np.linspace(0, 4, 200)])
    assert 0.02 < np.ptp(T[:, 1, 3]) < 0.06
    tilt = np.degrees(np.arccos(np.clip((np.trace(T[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 0.8 < tilt.max() < 4


def test_a_levelled_picture_is_upright_and_keeps_its_yaw() -> None:
    T = make_pose(so3_exp([0.1, 1.0, -0.2]), np.zeros(3))
    up = np.array([0.0, -1.0, 0.0])
    level = T[:3, :3] @ levelling(T, up)
    assert np.allclose(level[:, 1], -up)
    forward = T[:3, :3] @ [0, 0, 1]
    assert np.arctan2(level[0, 2], level[2, 2]) == pytest.approx(np.arctan2(forward[0], forward[2]), abs=0.05)
    locked = T[:3, :3] @ levelling(T, up, np.array([1.0, 0.3, 0.0]))
    assert np.allclose(locked[:, 1], -up)
    assert np.allclose(locked[:, 2], [1, 0, 0])


def test_a_tilting_camera_reaches_its_angle_and_keeps_its_yaw() -> None:
    still = np.repeat(np.eye(4)[None], 12, axis=0)
    ride = Ride(np.linspace(0, 20, 12), still, tilt=20)
    down = np.stack([ride.pose(t)[:3, 1] for t in np.linspace(0, 20, 300)])
    assert 19 < np.degrees(np.arccos(down[:, 1])).max() < 30


def test_two_lenses_share_the_sphere_and_agree_at_the_distance_they_are_stitched_for() -> None:
    rays = CAMERA.rays()
    front, back = lens_weights(rays)
    assert np.allclose(front + back, 1)
    assert front[4:60, 64].min() == 1  # straight ahead; the seam passes through the poles
    assert 0 < front[32, 32] < 1  # to the left
    a, b = lenses(rays, 0.041)
    assert np.allclose(a.origin - b.origin, [0, 0, 0.041])
    for lens in (a, b):
        point = lens.origin + lens.rays(rays) * np.linalg.norm(STITCHED_AT * rays - lens.origin, axis=-1)[..., None]
        assert np.allclose(point, STITCHED_AT * rays)
    # At half a metre to the side the two see things 0.041 (1 / 0.5 - 1 / 2) radians apart.
    apart = np.degrees(0.041 * (1 / 0.5 - 1 / STITCHED_AT))
    seen = [0.5 * np.array([1.0, 0, 0]) - lens.origin for lens in (a, b)]
    angles = [np.degrees(np.arctan2(s[2], s[0])) for s in seen]
    stitched = [np.degrees(np.arctan2(lens.rays(np.array([[[1.0, 0, 0]]]))[0, 0, 2], 1.0)) for lens in (a, b)]
    assert abs((angles[1] - angles[0]) - (stitched[1] - stitched[0])) == pytest.approx(apart, rel=0.02)


def test_rows_are_read_from_top_to_bottom() -> None:
    rows = row_times(CAMERA, CAMERA.rays())
    assert rows.min() >= -0.5
    assert rows.max() <= 0.5
    assert (np.diff(rows[:, 30]) > 0).all()  # near the rim of a lens
    assert rows[0].mean() == pytest.approx(-0.5 * 90 / 95, abs=0.02)
    assert np.ptp(rows[32]) < 0.03  # the horizon at once
    narrow = PinholeCamera(32, 24, 20.0, 20.0, 16.0, 12.0)
    assert np.allclose(row_times(narrow, narrow.rays())[:, 0], (np.arange(24) + 0.5) / 24 - 0.5)


def test_lens_gains_swing_by_the_stops_asked_for() -> None:
    swing = np.log2([gains(t, 0.3) for t in np.linspace(0, 60, 500)])
    assert np.abs(swing).max() == pytest.approx(0.4, abs=0.03)
    assert np.abs(swing[:, 0] - swing[:, 1]).max() > 0.3
    assert np.ptp(swing[:, 0, 0] - swing[:, 0, 2]) > 0.2

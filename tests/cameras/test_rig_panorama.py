"""A rig's panorama of many centres."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig import Rig
from panobench.cameras.rig_panorama import LensCentres, LensPictures, RigPanorama
from panobench.cameras.views import look_rotation
from panobench.geometry import make_pose
from panobench.testing import TinySequence, two_lenses

PANORAMA = ErpCamera(256, 128)


def test_each_pixel_is_what_its_lens_sees_from_its_own_centre() -> None:
    rig = two_lenses(136, 0.3)
    camera = RigPanorama.of(rig, PANORAMA)
    sequence = TinySequence(PANORAMA, 1, rig=rig)
    found = LensPictures(rig, camera).image(sequence.lens_images(0)).astype(float)
    seen = camera.valid_mask()
    for number, z in enumerate((0.15, -0.15)):
        own = seen & (camera.lens == number)
        expected = sequence.image_from(sequence.pose_at(0.0) @ make_pose(np.eye(3), [0, 0, z]), PANORAMA)
        other = sequence.image_from(sequence.pose_at(0.0), PANORAMA)
        off, from_the_middle = (np.abs(found - e)[own].mean() for e in (expected, other))
        assert off < 6
        assert from_the_middle > 2 * off


def test_where_lenses_meet_nothing_is_valid_at_any_size() -> None:
    camera = RigPanorama.of(two_lenses(136), PANORAMA)
    for size in (camera, camera.scaled(128), camera.scaled(64)):
        seen = size.valid_mask()
        columns = np.array([size.width // 4 - 1, size.width // 4, 3 * size.width // 4 - 1, 3 * size.width // 4])
        assert not seen[:, columns].any()
        assert size.solid_angle().sum() / (4 * np.pi) > 1 - 12 / size.width
    three = [look_rotation(angle).T for angle in (0.0, 120.0, 240.0)]
    lens = two_lenses(136).lenses[0].camera
    rig = Rig(tuple(type(two_lenses().lenses[0])(lens, make_pose(R, 0.05 * R[:, 2])) for R in three))
    around = RigPanorama.of(rig, PANORAMA)
    assert set(np.unique(around.lens)) == {0, 1, 2}
    neighbours = around.lens != np.roll(around.lens, 1, axis=1)
    assert not around.valid_mask()[neighbours].any()


def test_centres_follow_the_unit_of_the_map_and_stay_out_of_calibrations() -> None:
    camera = RigPanorama.of(two_lenses(136, 0.04), PANORAMA)
    assert camera.lenses is not None
    assert not camera.origins().any()  # as if there were one centre
    camera.lenses.units_per_metre = 2.0
    half = camera.scaled(128)
    np.testing.assert_allclose(np.abs(half.origins()[..., 2]), 0.04)
    assert half.lenses is camera.lenses
    assert camera.to_dict() == PANORAMA.to_dict()
    assert LensCentres.of(two_lenses(136, 0.04)).centres_m[0, 2] == pytest.approx(0.02)

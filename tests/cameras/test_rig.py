"""Rigs of several lenses, and their pictures stitched."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig import Rig, RigLens, seen_in_panorama
from panobench.cameras.stitching import Stitcher
from panobench.errors import CalibrationError
from panobench.testing import TinySequence, two_lenses


def test_a_rig_is_the_same_after_a_round_trip() -> None:
    rig = two_lenses()
    again = Rig.from_dict(rig.to_dict())
    assert again.to_dict() == rig.to_dict()
    assert again.baseline_m == pytest.approx(0.041)
    assert [lens.camera for lens in again.lenses] == [lens.camera for lens in rig.lenses]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lenses": []}, "needs a lens"),
        ({"lenses": 3}, "a rig is"),
        ({"colour": 1}, "unknown value 'colour'"),
        ({"lenses": [{"T_rig_lens": np.eye(4).tolist()}]}, "'camera' is missing"),
        ({"lenses": [{"camera": "x"}]}, "'camera' is missing"),
    ],
)
def test_values_that_make_no_rig(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        Rig.from_dict({**two_lenses().to_dict(), **change})


def test_poses_that_are_not_rigid() -> None:
    lens = two_lenses().lenses[0]
    for T in (2 * np.eye(4), np.diag([-1.0, 1, 1, 1]), np.full((4, 4), np.nan), np.eye(3)):
        with pytest.raises(CalibrationError, match="not a rigid 4x4 matrix"):
            Rig((RigLens(lens.camera, T),))
        values = {"model": "rig", "lenses": [{"camera": lens.camera.to_dict(), "T_rig_lens": T.tolist()}]}
        with pytest.raises(CalibrationError, match="4x4 matrix"):
            Rig.from_dict(values)


def test_centres_in_millimetres_are_refused() -> None:
    apart = [(lens, np.vstack([lens.T_rig_lens[:3] * [1, 1, 1, 1000], [0, 0, 0, 1]])) for lens in two_lenses().lenses]
    with pytest.raises(CalibrationError, match="41 m apart"):
        Rig(tuple(RigLens(lens.camera, T) for lens, T in apart))


def test_rows_are_read_around_the_frames_time() -> None:
    lens = two_lenses(96).lenses[0]
    assert lens.row_times() is None
    rows = RigLens(lens.camera, lens.T_rig_lens, readout_s=0.02).row_times()
    assert rows is not None
    assert rows.shape == (96,)
    assert rows.mean() == pytest.approx(0, abs=1e-12)
    assert np.ptp(rows) == pytest.approx(0.02 * 95 / 96)


def test_what_is_hidden_in_the_panorama_is_hidden_in_the_lenses() -> None:
    rig, camera = two_lenses(), ErpCamera(128, 64)
    mask = np.ones((64, 128), dtype=bool)
    mask[48:] = False  # from 45 degrees below the horizon on
    hidden = rig.with_masks(seen_in_panorama(rig, camera, mask))
    for lens, before in zip(hidden.lenses, rig.lenses):
        rays = lens.camera.rays() @ lens.T_rig_lens[:3, :3].T
        below = np.degrees(np.arcsin(np.clip(rays[..., 1], -1, 1)))
        valid = lens.camera.valid_mask()
        assert below[valid].max() < 48
        assert valid[below < 42].sum() == before.camera.valid_mask()[below < 42].sum()


def test_stitching_for_the_walls_distance_is_right_there() -> None:
    """Straight ahead the walls of the tiny room are 2 m away; two lenses stand 8 cm apart."""
    rig, camera = two_lenses(128, 0.08), ErpCamera(128, 64)
    sequence = TinySequence(camera, n=1, rig=rig)
    true = sequence.image(0).astype(float)
    near = np.abs(np.degrees(np.arccos(np.clip(np.abs(camera.rays()[..., 2]), 0, 1)))) < 40
    errors = {}
    for distance in (None, 2.0):
        stitcher = Stitcher(rig, camera, distance_m=distance)
        assert stitcher.valid.all()
        errors[distance] = np.abs(stitcher.image(sequence.lens_images(0)) - true)[near].mean()
    assert errors[2.0] < 0.75 * errors[None]


def test_without_a_baseline_nothing_is_left_of_the_seam() -> None:
    camera = ErpCamera(128, 64)
    errors = []
    for baseline in (0.0, 0.08):
        rig = two_lenses(256, baseline)
        sequence = TinySequence(camera, n=1, rig=rig)
        found = Stitcher(rig, camera).image(sequence.lens_images(0))
        errors.append(np.abs(found - sequence.image(0).astype(float)).mean())
    assert errors[0] < 0.6 * errors[1]


def test_scaling_keeps_the_poses() -> None:
    half = two_lenses(96).scaled(0.5)
    assert [lens.camera.width for lens in half.lenses] == [48, 48]
    np.testing.assert_array_equal(half.lenses[1].T_rig_lens, two_lenses(96).lenses[1].T_rig_lens)

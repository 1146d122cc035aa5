"""Frames are brought to the map's exposure when theirs plainly differs, and are left alone otherwise."""

import numpy as np
import pytest

from panobench.bench.record import read_record
from panobench.bench.request import RunRequest
from panobench.bench.runner import execute
from panobench.cameras.erp import ErpCamera
from panobench.methods.panogs.config import ExposureOptions
from panobench.methods.panogs.exposure import ExposureMatcher
from panobench.photometric.overlap import ViewWidth
from panobench.splat.loss import pixel_weights

CAMERA = ErpCamera(128, 64)


def picture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(60, 150, size=(8, 16, 3))
    return np.kron(coarse, np.ones((8, 8, 1))).astype(np.uint8)


def matcher(width: ViewWidth = ViewWidth.WIDE) -> ExposureMatcher:
    made = ExposureMatcher(pixel_weights(CAMERA), width, ExposureOptions())
    made.start(picture())
    return made


@pytest.mark.parametrize("gain", [0.6, 0.8, 1.3, 1.6])
def test_a_gain_is_taken_back(gain: float) -> None:
    changed = np.clip(picture() * gain, 0, 255).astype(np.uint8)
    back = matcher().before(changed)
    np.testing.assert_allclose(back.astype(float), picture().astype(float), atol=3)


def test_small_gains_and_narrow_views_are_left_alone() -> None:
    slightly = (picture() * 1.02).astype(np.uint8)
    assert matcher().before(slightly) is slightly
    much = (picture() * 1.4).astype(np.uint8)
    assert matcher(ViewWidth.NARROW).before(much) is much


def test_neither_a_rotation_nor_an_occluder_is_a_change_of_exposure() -> None:
    rotated = np.roll(picture(), 5, axis=1)
    covered = picture()
    covered[:, 20:52] = 70
    assert matcher().before(rotated) is rotated
    assert matcher().before(covered) is covered


def test_black_frames_have_no_gain() -> None:
    black = np.zeros_like(picture())
    assert matcher().before(black) is black


@pytest.mark.slow
def test_panogs_follows_a_swinging_exposure(tmp_path) -> None:  # type: ignore[no-untyped-def]
    errors = {}
    for match in (True, False):
        request = RunRequest(
            method="panogs", dataset="disturbed", sequence="rooms/tiny:rolling=0.3", width=128, max_frames=40,
            settings={"exposure.match": match},
        )  # fmt: skip
        run = read_record(execute(request, tmp_path / str(match)))
        errors[match] = run.number("ate_rmse_m") if run.number("tracked") == 1.0 else np.inf
    assert errors[True] < 0.03
    assert errors[True] < 0.5 * errors[False]
